"""`uncle map --track` from a folder of images to scores, as a user meets it."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result
from uncle.cli.main import main
from uncle.datasets.synth.write import SynthOptions, make_dataset
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.run.tracking_record import TrackingRecord

FRAMES = 24
QUICK = [
    "fusion.voxel_size_m=0.03",
    "fusion.min_observations=1",
    "field.iterations=5",
    "field.rays=256",
    "keyframes.rays=500",
    "uncertainty.steps_per_pass=60",
]


def uncle(*arguments: object) -> Result:
    result = CliRunner().invoke(main, list(map(str, arguments)))
    assert "Traceback" not in result.output
    return result


def done(*arguments: object) -> Result:
    result = uncle(*arguments)
    assert result.exit_code == 0, result.output
    return result


def track(run: Path, *arguments: object) -> Result:
    overrides = [word for override in QUICK for word in ("--set", override)]
    return uncle("map", "--run", run, "--track", "--device", "cpu", *overrides, *arguments)


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    """A short walk through a made room, with poses and its true mesh."""
    options = SynthOptions(frames=FRAMES, size_px=160, sensors=("sl",))
    return make_dataset(tmp_path_factory.mktemp("synth") / "room", options)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Six views of nothing, without poses, in the `folder` format: black, one depth 20 m away."""
    camera = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 31.5, "cy": 23.5}
    data = tmp_path / "data"
    for name in ("color", "depth_a"):
        (data / name).mkdir(parents=True)
    (data / "camera.json").write_text(json.dumps(camera))
    for index in range(6):
        cv2.imwrite(str(data / f"color/{index:04d}.png"), np.zeros((48, 64, 3), np.uint8))
        cv2.imwrite(str(data / f"depth_a/{index:04d}.png"), np.full((48, 64), 20_000, np.uint16))
    return data


def test_room_from_images_to_scores(room, tmp_path):
    run = tmp_path / "run"
    done("preprocess", room, "--run", run)
    result = track(run)
    assert result.exit_code == 0, result.output
    assert f"Mapped {FRAMES} frames" in result.stderr
    assert "lost" not in result.stderr
    assert "enabled = true" in (run / "config.toml").read_text()
    done("mesh", "--run", run)
    done("eval", "--run", run)
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["trajectory"]["ate_m"]["rmse"] < 0.01
    assert metrics["surface"]["mesh"]["scores"][-1]["f_score"] > 0.85


def test_without_colour_and_held_out_frames(room, tmp_path):
    run = tmp_path / "run"
    done("preprocess", room, "--run", run, "--frames", ":12")
    assert track(run, "--no-color", "--hold-out", 4).exit_code == 0
    frames = TrackingRecord.load(run / "tracking.json").frames
    assert [f.index for f in frames] == [0, 1, 2, 4, 5, 6, 8, 9, 10]
    assert all(f.matches == 0 for f in frames)
    posed = [f.timestamp for f in frames if f.status != "lost"]
    np.testing.assert_allclose(Trajectory.load(run / "trajectory.txt").timestamps, posed, atol=1e-6)
    assert "color = false" in (run / "config.toml").read_text()


@pytest.mark.parametrize("method", ["uncle", "tsdf"])
def test_a_recording_that_shows_nothing(folder, tmp_path, method):
    run = tmp_path / "run"
    done("preprocess", folder, "--run", run)
    arguments = () if method == "uncle" else ("--method", "tsdf")
    result = track(run, *arguments)
    assert result.exit_code == 1
    errors = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert len(errors) == 1
    assert "lost in all 6 frames" in errors[0]
    assert not (run / "trajectory.txt").exists()


def test_poses_are_needed_or_tracked(folder, tmp_path):
    run = tmp_path / "run"
    done("preprocess", folder, "--run", run)
    result = uncle("map", "--run", run)
    assert result.exit_code == 1
    assert "--track" in result.stderr


def test_no_color_is_about_tracking(tmp_path):
    result = uncle("map", "--run", tmp_path, "--no-color")
    assert result.exit_code == 2
    assert "add --track" in result.stderr
