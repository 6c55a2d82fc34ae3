"""`uncle uncertainty` and `uncle map --prior` as a user meets them."""

import json
import shutil
import time

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result
from uncle.cli.main import main
from uncle.recon.run.directory import RunDirectory

QUICK = [
    "fusion.voxel_size_m=0.05",
    "fusion.passes=0",
    "fusion.min_observations=2",
    "keyframes.rays=200",
    "field.iterations=3",
    "uncertainty.steps_per_keyframe=1",
    "uncertainty.steps_per_pass=5",
    "uncertainty.batch=64",
]


def uncle(*arguments: object) -> Result:
    return CliRunner().invoke(main, list(map(str, arguments)))


def uncle_map(run: RunDirectory, *arguments: object) -> Result:
    overrides = [word for override in QUICK for word in ("--set", override)]
    return uncle("map", "--run", run.root, "--device", "cpu", *overrides, *arguments)


def one_line(result: Result) -> str:
    """The message of a command that failed on purpose."""
    assert result.exit_code == 1, result.output
    assert "Traceback" not in result.output
    assert result.stderr.strip().splitlines()[-1].startswith("Error: ")
    return result.stderr.strip().splitlines()[-1]


def finish_map(run: RunDirectory, share: object) -> RunDirectory:
    run.finish_stage("map", "0", time.time(), {"method": "uncle", "sensor_weight_share": share})
    return run


@pytest.fixture
def run(make_mappable_run) -> RunDirectory:
    """Sensor `noisy` has Laplace errors of scale 1 % of depth squared, and its beta maps say so."""
    return finish_map(make_mappable_run(), {"noisy": 0.25})


def test_figures_are_those_of_the_sensor(run):
    result = uncle("uncertainty", "--run", run.root, "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["skipped"] == {}
    noisy = found["sensors"]["noisy"]
    assert noisy["weight_share"] == 0.25
    assert noisy["beta_at_m"]["2"] == pytest.approx(0.04, rel=0.1)
    assert noisy["beta_at_m"]["1"] is noisy["beta_at_m"]["5"] is None  # no wall is that near or far
    assert noisy["low_beta_m"] < noisy["median_beta_m"] < noisy["high_beta_m"]
    assert noisy["scores"]["coverage_50"] == pytest.approx(0.5, abs=0.02)
    assert noisy["scores"]["mean_error_m"] == pytest.approx(noisy["scores"]["mean_beta_m"], rel=0.03)
    names = [f"{kind}_noisy.png" for kind in ("sensor", "noise", "uncertainty_calibration")]
    assert found["pictures"] == [str(run.snapshots_path / name) for name in (*names, "reliability.png")]
    assert all(cv2.imread(path) is not None for path in found["pictures"])


def test_table_has_a_column_for_each_sensor(run):
    result = uncle("uncertainty", "--run", run.root)
    assert result.exit_code == 0, result.output
    lines = {line.split("│")[1].strip(): line.split("│")[2:4] for line in result.stdout.splitlines() if "│" in line}
    assert [cell.strip() for cell in lines["weight share"]] == ["25.0", "%"]
    assert [cell.strip() for cell in lines["beta at 5 m"]] == ["-", "cm"]
    assert float(lines["beta at 2 m"][0]) == pytest.approx(4.0, rel=0.1)
    assert "coverage of the 50 % interval" in lines
    assert "drawn: " in result.stderr
    assert ".png" not in result.stdout


def test_one_frame_into_another_folder(run, tmp_path):
    few, one = tmp_path / "few", tmp_path / "one"
    assert uncle("uncertainty", "--run", run.root, "--out", few).exit_code == 0
    result = uncle("uncertainty", "--run", run.root, "--sensor", "noisy", "--frame", 4, "--out", one)
    assert result.exit_code == 0, result.output
    heights = [cv2.imread(str(folder / "sensor_noisy.png")).shape[0] for folder in (few, one)]
    assert heights[1] < 0.6 * heights[0]  # one row of pictures in the place of three
    assert not run.snapshots_path.exists()
    run.beta_path("noisy", 4).unlink()
    result = uncle("uncertainty", "--run", run.root, "--frame", 4, "--out", one)
    assert result.exit_code == 0, result.output
    assert "frame 4 of noisy has no beta map" in result.stderr


def test_without_a_truth_there_are_no_scores(make_mappable_run):
    run = finish_map(make_mappable_run(("noisy",)), None)
    result = uncle("uncertainty", "--run", run.root, "--json")
    assert result.exit_code == 0, result.output
    noisy = json.loads(result.stdout)["sensors"]["noisy"]
    assert noisy["scores"] is None
    assert noisy["weight_share"] is None
    assert not (run.snapshots_path / "uncertainty_calibration_noisy.png").exists()
    assert (run.snapshots_path / "noise_noisy.png").exists()
    assert "coverage" not in uncle("uncertainty", "--run", run.root).stdout


def test_sensors_outside_the_map_are_named(make_mappable_run):
    run = finish_map(make_mappable_run(("gt", "noisy", "other")), {"noisy": 1.0})
    shutil.rmtree(run.beta_path("other", 0).parent)
    result = uncle("uncertainty", "--run", run.root)
    assert result.exit_code == 0, result.output
    assert "left out: other: it has no beta maps" in result.stdout
    assert "has no uncertainty of other" in one_line(uncle("uncertainty", "--run", run.root, "--sensor", "other"))


def test_mistakes_are_one_line(run, make_box_run, tmp_path):
    assert "no such estimated sensor" in one_line(uncle("uncertainty", "--run", run.root, "--sensor", "sl"))
    assert "no such estimated sensor; it has: noisy" in one_line(
        uncle("uncertainty", "--run", run.root, "--sensor", "gt")
    )
    assert "frames 0 to 11" in one_line(uncle("uncertainty", "--run", run.root, "--frame", 12))
    assert "uncle preprocess" in one_line(uncle("uncertainty", "--run", tmp_path / "none"))
    assert "uncle map" in one_line(uncle("uncertainty", "--run", make_box_run().root))
    assert uncle("uncertainty", "--run", run.root, "--frame", "-1").exit_code == 2


def test_map_learns_what_uncertainty_shows_and_the_next_map_starts_from(make_mappable_run, tmp_path):
    run = make_mappable_run(angles=np.linspace(0, 2 * np.pi, 6, endpoint=False))
    assert uncle_map(run, "--sensors", "gt", "noisy").exit_code == 0
    found = json.loads(uncle("uncertainty", "--run", run.root, "--json").stdout)
    assert 0 < found["sensors"]["noisy"]["weight_share"] < 1
    earlier = tmp_path / "earlier"
    shutil.copytree(run.root, earlier)
    for prior in (earlier, earlier / "map" / "noise_model.pt"):
        result = uncle_map(run, "--prior", prior, "--overwrite")
        assert result.exit_code == 0, result.output
        assert run.load_manifest().stages["map"].facts["prior"]["sensors"] == ["noisy"]
        assert "done and unchanged" in uncle_map(run, "--prior", prior).stderr
    assert "Mapped" in uncle_map(run).stderr


def test_priors_that_cannot_be_used(make_mappable_run, tmp_path):
    run = make_mappable_run(angles=np.linspace(0, 2 * np.pi, 6, endpoint=False))
    (tmp_path / "text.pt").write_text("no model")
    for prior, said in ((tmp_path / "none.pt", "no such file"), (tmp_path / "text.pt", "not a file of noise models"),
                        (tmp_path, "uncle preprocess"), (run.root, "uncle map")):  # fmt: skip
        assert said in one_line(uncle_map(run, "--prior", prior))
    assert "map" not in run.load_manifest().stages
