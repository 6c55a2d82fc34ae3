"""What people get wrong: it ends in one line and exit code 1 or 2 or in a reported skip, and costs nothing."""

import errno
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from uncle.cli.main import main
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames

CAMERA = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 31.5, "cy": 23.5}
FRAMES = 4


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A sound recording of two sensors with poses, in the `folder` format."""
    folder = tmp_path / "data"
    for name in ("color", "depth_a", "depth_b", "poses"):
        (folder / name).mkdir(parents=True)
    (folder / "camera.json").write_text(json.dumps(CAMERA))
    rng = np.random.default_rng(0)
    for index in range(FRAMES):
        cv2.imwrite(str(folder / f"color/{index:04d}.png"), rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
        for sensor in ("a", "b"):
            depth = rng.integers(1500, 1600, (48, 64)).astype(np.uint16)
            cv2.imwrite(str(folder / f"depth_{sensor}/{index:04d}.png"), depth)
        np.savetxt(folder / f"poses/{index:04d}.txt", np.eye(4))
    return folder


@pytest.fixture
def preprocess(tmp_path: Path):
    def invoke(dataset: Path, *arguments: str, run: Path | None = None):
        line = ["preprocess", str(dataset), "--run", str(run or tmp_path / "run"), *arguments]
        return CliRunner().invoke(main, line)

    return invoke


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


def is_one_line(result, *words: str, code: int = 1) -> None:
    """The command failed with a message for people that holds `words`."""
    assert result.exit_code == code, result.output
    assert isinstance(result.exception, SystemExit)
    errors = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
    assert len(errors) == 1
    assert result.stderr.splitlines()[-1] == errors[0]
    assert "Traceback" not in result.output
    for word in words:
        assert word in errors[0]
    assert result.stdout == ""


def frames_of(tmp_path: Path) -> RunFrames:
    return RunFrames(RunDirectory(tmp_path / "run"))


def test_a_sound_recording_passes(data, preprocess, tmp_path):
    result = preprocess(data)
    assert result.exit_code == 0, result.output
    assert "warning" not in result.output
    assert f"uncle map --run {tmp_path / 'run'}" in result.stderr
    assert len(frames_of(tmp_path)) == FRAMES


def test_missing_folder(preprocess, tmp_path):
    is_one_line(preprocess(tmp_path / "nowhere"), "nowhere", "does not exist")
    assert not (tmp_path / "run").exists()


def test_empty_folder(preprocess, tmp_path):
    (tmp_path / "empty").mkdir()
    is_one_line(preprocess(tmp_path / "empty"), "empty")


def test_a_file_instead_of_a_folder(preprocess, tmp_path):
    (tmp_path / "movie.mp4").write_bytes(b"0")
    is_one_line(preprocess(tmp_path / "movie.mp4"), "movie.mp4", "folder")


def test_a_folder_of_something_else(preprocess, tmp_path):
    (tmp_path / "music").mkdir()
    (tmp_path / "music" / "song.flac").write_bytes(b"0")
    is_one_line(preprocess(tmp_path / "music"), "music", "--format")


def test_unknown_format(data, preprocess):
    is_one_line(preprocess(data, "--format", "kinect"), "kinect", "tum")


def test_a_truncated_jpg_is_skipped(data, preprocess, tmp_path):
    for path in sorted((data / "color").iterdir()):
        cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path)))
        path.unlink()
    path = data / "color" / "0001.jpg"
    path.write_bytes(path.read_bytes()[:-300])
    result = preprocess(data)
    assert result.exit_code == 0, result.output
    assert "0001.jpg" in result.stderr
    assert [record.source_index for record in frames_of(tmp_path).records] == [0, 2, 3]


@pytest.mark.parametrize("folder", ["color", "depth_a"])
def test_a_truncated_png_is_skipped_and_reported(data, preprocess, tmp_path, folder):
    path = data / folder / "0002.png"
    path.write_bytes(path.read_bytes()[:-300])
    result = preprocess(data)
    assert result.exit_code == 0, result.output
    warnings = [line for line in result.stderr.splitlines() if line.startswith("warning: ")]
    assert len(warnings) == 1
    assert "0002.png" in warnings[0]
    kept = [record.source_index for record in frames_of(tmp_path).records]
    assert kept == ([0, 1, 3] if folder == "color" else [0, 1, 2, 3])
    assert [*frames_of(tmp_path).run.load_manifest().skipped] == ["2" if folder == "color" else "2/a"]


def test_every_png_truncated(data, preprocess):
    for path in (data / "color").iterdir():
        path.write_bytes(path.read_bytes()[:100])
    is_one_line(preprocess(data), "0000.png")


def test_8_bit_depth(data, preprocess):
    for path in (data / "depth_a").iterdir():
        cv2.imwrite(str(path), np.full((48, 64), 100, np.uint8))
    is_one_line(preprocess(data, "--sensors", "a"), "8-bit", "0000.png")


def test_wrong_size(data, preprocess):
    for path in (data / "depth_b").iterdir():
        cv2.imwrite(str(path), np.full((24, 32), 1000, np.uint16))
    is_one_line(preprocess(data, "--sensors", "b"), "64x48", "32x24")


def test_one_sensor_that_is_never_readable_names_the_way_out(data, preprocess):
    for path in (data / "depth_b").iterdir():
        path.write_bytes(b"junk")
    is_one_line(preprocess(data), "sensor b", "--sensors a")


def test_a_nan_pose_is_reported_and_its_frame_kept(data, preprocess, tmp_path):
    np.savetxt(data / "poses/0001.txt", np.full((4, 4), np.nan))
    result = preprocess(data)
    assert result.exit_code == 0, result.output
    assert "1 of 4 frames have no usable pose" in result.stderr
    assert [frames_of(tmp_path).pose(index) is None for index in range(FRAMES)] == [False, True, False, False]


def test_no_overlap_of_time_stamps(preprocess, tmp_path):
    folder = tmp_path / "rgbd_dataset_freiburg1_none"
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True)
    for name, start in (("rgb", 100.0), ("depth", 500.0)):
        lines = [f"{start + i / 30:.6f} {name}/{start + i / 30:.6f}.png" for i in range(3)]
        (folder / f"{name}.txt").write_text("\n".join(["# header", *lines]) + "\n")
        for line in lines:
            cv2.imwrite(str(folder / line.split()[1]), np.full((480, 640), 5000, np.uint16))
    is_one_line(preprocess(folder), "freiburg1_none", "time stamps")


def test_unknown_sensor(data, preprocess):
    is_one_line(preprocess(data, "--sensors", "a", "lidar"), "lidar", "a, b")


def test_zero_valid_depth(data, preprocess):
    for path in (data / "depth_b").iterdir():
        cv2.imwrite(str(path), np.zeros((48, 64), np.uint16))
    is_one_line(preprocess(data), "sensor b", "--sensors a")
    is_one_line(preprocess(data, "--sensors", "b"), "sensor b")


@pytest.mark.parametrize("arguments", [["--frames", "3"], ["--frames", "a:b"], ["--sensors"], ["--sensor", "a"]])
def test_usage_errors(data, preprocess, arguments):
    is_one_line(preprocess(data, *arguments), code=2)


def test_no_frames_in_the_range(data, preprocess):
    is_one_line(preprocess(data, "--frames", "90:"), "--frames", "4 frames")


def test_a_file_where_the_run_should_be(data, preprocess, tmp_path):
    (tmp_path / "file").write_text("mine")
    is_one_line(preprocess(data, run=tmp_path / "file"), "file", code=2)
    is_one_line(preprocess(data, run=tmp_path / "file" / "run"), "--run")
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("number", "words"), [(errno.EROFS, "read-only"), (errno.EACCES, "permission"), (errno.ENOSPC, "disk is full")]
)
def test_a_run_that_cannot_be_written(data, preprocess, tmp_path, monkeypatch, number, words):
    """As root no folder is read-only, so the system calls that would be refused are replaced."""
    run = tmp_path / "run"
    assert preprocess(data).exit_code == 0
    before = contents(run)
    mkdir, write_bytes = Path.mkdir, Path.write_bytes

    def refuse(path: Path) -> None:
        if path.is_relative_to(run):
            raise OSError(number, "refused", str(path))

    with monkeypatch.context() as patch:
        if number == errno.ENOSPC:
            patch.setattr(Path, "write_bytes", lambda self, data: (refuse(self), write_bytes(self, data))[1])
        else:
            patch.setattr(Path, "mkdir", lambda self, *a, **k: (refuse(self), mkdir(self, *a, **k))[1])
        is_one_line(preprocess(data, "--overwrite"), words, str(run))
    assert contents(run) == before
    assert preprocess(data).exit_code == 0


def test_a_failed_redo_keeps_the_run(data, preprocess, tmp_path):
    assert preprocess(data).exit_code == 0
    before = contents(tmp_path / "run")
    for path in (data / "depth_a").iterdir():
        path.write_bytes(b"junk")
    is_one_line(preprocess(data), "sensor a")
    assert contents(tmp_path / "run") == before


@pytest.mark.parametrize("command", ["map", "mesh", "eval", "report"])
def test_commands_on_no_run_name_the_command_that_makes_one(command, tmp_path):
    result = CliRunner().invoke(main, [command, "--run", str(tmp_path / "none")])
    is_one_line(result, "uncle preprocess")
    assert not (tmp_path / "none").exists()


def test_unknown_sensor_of_a_run(data, preprocess, tmp_path):
    assert preprocess(data).exit_code == 0
    result = CliRunner().invoke(main, ["map", "--run", str(tmp_path / "run"), "--sensors", "lidar"])
    is_one_line(result, "lidar", "a, b")
