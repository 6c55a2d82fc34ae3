"""`uncle bench paper` on a small made room, from the command line to the tables."""

import json
import shutil
from types import SimpleNamespace

import pytest
from click.testing import CliRunner
from uncle.cli.main import main
from uncle.datasets.synth.write import SynthOptions, make_dataset
from uncle.recon.core.errors import RunError
from uncle.recon.evaluation.bench import paper, process
from uncle.recon.evaluation.bench.methods import Catalogue
from uncle.recon.methods.registry import method_specs


def bench(*arguments):
    return CliRunner().invoke(main, ["bench", "paper", *map(str, arguments)])


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """Two calls: the second also names a data set that is not there."""
    place = tmp_path_factory.mktemp("bench")
    make_dataset(place / "room", SynthOptions(frames=8, size_px=64, seed=1, sensors=("sl",)))
    out = place / "out"
    line = [place / "room", "--methods", "tsdf", "--settings", "given", "--set", "fusion.voxel_size_m=0.08"]
    line += ["--set", "fusion.min_observations=1", "--out", out, "--seeds"]
    first = bench(*line, 1)
    records = json.loads((out / "runs.json").read_text())
    second = bench(*line, 1, place / "nowhere")
    return SimpleNamespace(out=out, first=first, second=second, records=records)


def test_every_job_is_run_and_scored(done):
    assert done.first.exit_code == 0, done.first.output
    (given,) = done.records.values()
    assert (given["setting"], given["method"], given["sensors"]) == ("given", "tsdf", "sl")
    assert given["f_score_5cm"] > 0.2
    assert given["depth_l1_m"] > 0
    assert "ate_m" not in given  # the poses were given
    assert given["frames_per_s"] == pytest.approx(8 / given["wall_s"], rel=0.01)
    assert given["peak_memory_mb"] > 50


def test_a_second_call_goes_on_and_reports_what_is_missing(done):
    assert done.second.exit_code == 1
    assert "nowhere" in done.second.output
    assert json.loads((done.out / "runs.json").read_text()) == done.records  # nothing was run again
    assert "1 of the runs failed" in done.second.output


def test_tables_are_written_in_three_formats(done):
    text = (done.out / "paper.md").read_text()
    assert "## Single sensor, given poses" in text
    assert "| nowhere |" in text
    assert "All figures" in text
    assert "All figures" not in done.first.stdout
    html = (done.out / "paper.html").read_text()
    assert html.startswith("<!DOCTYPE html>")
    assert "src=" not in html
    facts = json.loads((done.out / "paper.json").read_text())
    assert {figure["figure"] for figure in facts["figures"]} >= {"f_score_5cm", "depth_l1_m", "wall_s"}
    assert list(facts["left_out"]) == ["nowhere"]


def test_only_small_files_of_a_run_are_kept(done):
    (run,) = (done.out / "room" / "runs").iterdir()
    names = {path.name for path in run.iterdir()}
    assert {"metrics.json", "config.toml", "log.txt", "trajectory.txt"} <= names <= set(paper.KEPT)
    assert (done.out / "room" / "base" / "frames").is_dir()


def test_a_failed_run_is_in_the_table_and_the_others_go_on(done, monkeypatch):
    room, out = done.out.parent / "room", done.out.parent / "other"
    shutil.copytree(done.out, out)  # preprocessed

    def loses_the_camera(command, *arguments, **options):
        if command == "map":
            raise RunError("uncle map: the camera was lost")
        return 0.0

    monkeypatch.setattr(process, "uncle", loses_the_camera)
    failed = bench(room, "--methods", "tsdf", "--settings", "rgbd", "--seeds", 2, "--out", out)
    assert failed.exit_code == 1
    assert "- [1] tsdf: on sl of room, seed 0, 1 failed: uncle map: the camera was lost" in failed.output
    facts = json.loads((out / "paper.json").read_text())
    assert facts["failed"][0]["row"] == ["room", "sl", "rgbd", "tsdf"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--methods", "elastic"], "unknown method 'elastic'"),
        (["--set", "fusion.voxels=1"], "no setting is called"),
        (["--ablation", "6K2FS"], "no variant or group"),
        (["--settings", "mono"], "'mono' is not one of"),
        (["--methods"], "--methods needs at least one value"),
    ],
)
def test_wrong_arguments_are_told_before_anything_runs(tmp_path, arguments, message):
    result = bench("synth:7", "--out", tmp_path / "out", *arguments)
    assert result.exit_code in (1, 2)
    assert message in result.output
    assert not (tmp_path / "out").exists()


def test_options_of_a_job_are_those_of_the_command(tmp_path):
    job = paper.Job("room", "sl+sgm", "depth", "uncle", "mine", 3, ("b=2",), 0, "abc")
    choice = paper.Choice(("uncle",), overrides=("a=1",), device="cpu", catalogue=Catalogue(method_specs()))
    words = " ".join(paper.map_options(job, choice))
    assert words == (
        "--overwrite --method uncle --track --no-color --sensors sl sgm --seed 3 --device cpu --set a=1 --set b=2"
    )
    paper_words = " ".join(paper.map_options(job._replace(method="nice-slam"), choice))
    assert paper_words.endswith("--set nice.color=false --set a=1 --set b=2")  # nothing of colour, as in the paper
    assert "--hold-out 10" in " ".join(paper.map_options(job._replace(hold_out=10), choice))
