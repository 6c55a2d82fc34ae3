"""The learned baselines from the command line: training, and `uncle map --method senfunet`."""

import json

import numpy as np
import pytest
import torch
from click.testing import CliRunner, Result
from uncle.cli.main import main
from uncle.recon.methods.confidence.models import ConfidenceModels
from uncle.recon.methods.senfunet.models import SenfunetModel
from uncle.recon.run.directory import RunDirectory


def uncle(*arguments: object) -> Result:
    return CliRunner().invoke(main, list(map(str, arguments)))


@pytest.fixture
def run(make_mappable_run) -> RunDirectory:
    """The box room with true depth and two sensors of the same noise."""
    return make_mappable_run(("gt", "left", "right"), np.linspace(0, 2 * np.pi, 10, endpoint=False))


@pytest.fixture
def pair(tmp_path):
    """A file of untrained networks for the sensors left and right."""
    path = tmp_path / "pair.pt"
    SenfunetModel.fresh(("left", "right"), 0.06, torch.Generator().manual_seed(0)).save(path, {})
    return path


def uncle_map(run: RunDirectory, *arguments: object) -> Result:
    fixed = ["--method", "senfunet", "--voxel", 0.06, "--device", "cpu"]
    return uncle("map", "--run", run.root, *fixed, *arguments)


def surface_scores(run: RunDirectory) -> dict[str, float]:
    """Precision and recall at 5 cm of what the cameras saw."""
    assert uncle("mesh", "--run", run.root).exit_code == 0
    files = [run.mesh_path, run.load_manifest().reference_mesh, "--cull", run.root]
    done = uncle("eval", *files, "--threshold", 0.05, "--samples", 20_000, "--views", 0, "--json")
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)["mesh"]["scores"][0]


def test_one_sensor_is_fused_alone(run):
    done = uncle_map(run, "--sensors", "left")
    assert done.exit_code == 0, done.output
    assert run.load_manifest().stages["map"].facts["method"] == "senfunet"
    scores = surface_scores(run)
    assert scores["precision"] > 0.97
    assert scores["recall"] > 0.85


def test_two_sensors_are_fused_by_the_networks_of_a_file(run, pair):
    given = ["--sensors", "right", "left", "--set", f"senfunet.file={pair}", "--set", "senfunet.outlier_filter=false"]
    done = uncle_map(run, *given)
    assert done.exit_code == 0, done.output
    scores = surface_scores(run)
    assert scores["precision"] > 0.97
    assert scores["recall"] > 0.85
    assert "done and unchanged" in uncle_map(run, *given).stderr
    SenfunetModel.fresh(("left", "right"), 0.02, torch.Generator().manual_seed(1)).save(pair, {})
    again = uncle_map(run, *given)  # other networks, another map
    assert "Mapped" in again.stderr
    assert "trained on voxels of 2 cm, not 6 cm" in again.stderr


def test_more_sensors_and_unknown_pairs_are_refused(run):
    three = uncle_map(run, "--sensors", "gt", "left", "right")
    assert three.exit_code == 1
    assert "senfunet fuses at most 2 sensors" in three.stderr
    unknown = uncle_map(run, "--sensors", "left", "right")
    assert unknown.exit_code == 1
    assert "uncle pretrain senfunet DATASET --sensors left right" in unknown.stderr
    assert "map" not in run.load_manifest().stages


def test_senfunet_is_trained_from_a_run_or_a_prepared_file(run, tmp_path):
    scenes, out = tmp_path / "scenes.npz", tmp_path / "trained.pt"
    size = ["--voxel", 0.1, "--images", 3]
    done = uncle("pretrain", "senfunet", run.root, "--sensors", "left", "right", *size, "--prepare", scenes)
    assert done.exit_code == 0, done.output
    short = ["--frames", 3, "--bricks", 2, "--accumulate", 1, "--device", "cpu"]
    done = uncle("pretrain", "senfunet", "--data", scenes, "--sensors", "right", "left", *short, "--out", out)
    assert done.exit_code == 0, done.output
    assert "mean error where both sensors read something: right" in done.stderr
    model = SenfunetModel.load(("left", "right"), out)
    assert (model.sensors, model.voxel_size_m) == (("right", "left"), 0.1)


def test_confidence_is_trained_from_a_run_or_a_prepared_file(run, tmp_path):
    pairs, out = tmp_path / "pairs.npz", tmp_path / "left.pt"
    done = uncle("pretrain", "confidence", run.root, "--sensor", "left", "--frames", 5, "--prepare", pairs)
    assert done.exit_code == 0, done.output
    assert f"--data {pairs}" in done.stderr
    short = ["--steps", 2, "--batch", 1, "--crop", 32, "--device", "cpu"]
    done = uncle("pretrain", "confidence", "--data", pairs, *short, "--out", out)
    assert done.exit_code == 0, done.output
    assert "left, 2 steps, loss of frames held back" in done.stderr
    image = ConfidenceModels.load(["left"], [out]).image("left", torch.full((48, 64), 2.0))
    assert 0 < float(image.mean()) < 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["confidence", "--sensor", "sl", "--out", "x.pt"], "--data"),
        (["confidence", ".", "--out", "x.pt"], "--sensor is missing"),
        (["confidence", ".", "--sensor", "sl"], "--out"),
        (["senfunet", "--sensors", "sl", "sgm", "--out", "x.pt"], "--data"),
        (["senfunet", ".", "--sensors", "sl", "--out", "x.pt"], "two sensors"),
        (["senfunet", ".", "--sensors", "sl", "sgm"], "--out"),
    ],
)
def test_incomplete_commands_say_what_is_missing(arguments, message):
    done = uncle("pretrain", *arguments)
    assert done.exit_code == 2
    assert message in done.output
