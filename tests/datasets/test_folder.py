import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from uncle.datasets import open_dataset
from uncle.recon.errors import DataError, FrameError

DOCS = Path(__file__).resolve().parents[2] / "docs" / "own-data.md"


def set_camera(folder: Path, **changes) -> None:
    fields = json.loads((folder / "camera.json").read_text()) | changes
    (folder / "camera.json").write_text(json.dumps(fields))


def write_poses(folder: Path, room, count: int = 3) -> None:
    for index, pose in enumerate(room.poses(count)):
        room.write_matrix(folder / "poses" / f"{index:04d}.txt", pose)


@pytest.mark.parametrize("color", [".png", ".jpg"])
def test_matrices_and_several_sensors_land_on_the_room(write_folder, room, color):
    folder = write_folder(sensors=("depth_tof", "depth_stereo"), color=color)
    write_poses(folder, room)
    recording = open_dataset(folder)
    assert (recording.format, recording.name, recording.sensors) == ("folder", "own", ("stereo", "tof"))
    assert not recording.has_timestamps
    tolerance = 0.012 if color == ".png" else 0.03  # JPG keeps colour at half the resolution
    for sensor in recording.sensors:
        room.check(recording, sensor, tolerance)


def test_pose_text_counts_frames_where_there_is_no_clock(write_folder, room, pose_line):
    folder = write_folder()
    poses = room.poses(3)
    (folder / "poses.txt").write_text("\n".join(pose_line(index, poses[index]) for index in (0, 2)))
    recording = open_dataset(folder)
    np.testing.assert_allclose(recording.pose(2), poses[2], atol=1e-8)
    assert recording.pose(1) is None


def test_pose_text_is_interpolated_at_the_time_stamps(write_folder, pose_line):
    folder = write_folder()
    (folder / "timestamps.txt").write_text("# seconds\n10.00\n10.02\n10.05\n")
    poses = [np.eye(4), np.eye(4)]
    poses[1][0, 3] = 1.0
    (folder / "poses.txt").write_text(pose_line(10.0, poses[0]) + "\n" + pose_line(10.05, poses[1]))
    recording = open_dataset(folder)
    assert recording.has_timestamps
    assert recording[1].timestamp == 10.02
    assert [recording.pose(index)[0, 3] for index in range(3)] == pytest.approx([0.0, 0.4, 1.0])


def test_poses_are_optional(write_folder):
    recording = open_dataset(write_folder())
    assert not recording.has_poses
    assert recording[0].T_world_camera is None
    assert recording.sensors == ("depth",)


def test_depth_scale_of_the_camera_file(write_folder):
    folder = write_folder()
    in_millimetres = open_dataset(folder)[0].depths["depth"]
    set_camera(folder, depth_scale=500)
    np.testing.assert_allclose(open_dataset(folder)[0].depths["depth"], 2 * in_millimetres, rtol=1e-6)


def test_sensor_may_miss_frames(write_folder):
    folder = write_folder(sensors=("depth_a", "depth_b"))
    (folder / "depth_b" / "0001.png").unlink()
    recording = open_dataset(folder)
    frame = recording[1]
    assert frame.depths["a"].any()
    assert not frame.depths["b"].any()
    assert "sensor b has no image in 1 of 3 frames" in recording.notes


def test_one_broken_frame_leaves_the_others(write_folder):
    folder = write_folder()
    path = folder / "depth" / "0001.png"
    path.write_bytes(path.read_bytes()[:-200])
    recording = open_dataset(folder)
    with pytest.raises(FrameError, match=r"frame 1: .*0001\.png"):
        recording[1]
    assert recording[0].depths["depth"].any()
    assert recording[2].depths["depth"].any()


def test_eight_bit_depth_is_refused(write_folder):
    folder = write_folder()
    cv2.imwrite(str(folder / "depth" / "0000.png"), np.full((48, 64), 100, np.uint8))
    with pytest.raises(FrameError, match="8-bit; depth must be 16-bit"):
        open_dataset(folder)[0]


@pytest.mark.parametrize(("name", "dtype"), [("color/0000.png", np.uint8), ("depth/0000.png", np.uint16)])
def test_wrong_size_names_both(write_folder, name, dtype):
    folder = write_folder()
    shape = (24, 32, 3) if "color" in name else (24, 32)
    cv2.imwrite(str(folder / name), np.ones(shape, dtype))
    with pytest.raises(FrameError, match="expected 64x48, found 32x24"):
        open_dataset(folder)[0]


def test_iteration_ends_and_negative_indices_count_from_the_end(write_folder):
    recording = open_dataset(write_folder())
    assert [frame.index for frame in recording] == [0, 1, 2]
    assert recording[-1].index == 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx": -1}, "fx"),
        ({"focal": 3}, "focal"),
        ({"width": None}, "width"),
        ({"distortion": [0.1]}, "distortion"),
        ({"timestamps": "clock.txt"}, "clock.txt"),
    ],
)
def test_bad_camera_file_names_the_field(write_folder, changes, message):
    folder = write_folder()
    set_camera(folder, **changes)
    with pytest.raises(DataError, match=message):
        open_dataset(folder)


def test_camera_file_that_is_no_json(write_folder):
    folder = write_folder()
    (folder / "camera.json").write_text("{")
    with pytest.raises(DataError, match=r"camera\.json"):
        open_dataset(folder)


@pytest.mark.parametrize("text", ["1\n2\n", "1\n2\n2\n", "1\n3\n2\n", "1\nnan\n2\n", "1\nnoon\n2\n"])
def test_bad_time_stamps_are_refused(write_folder, text):
    folder = write_folder()
    (folder / "timestamps.txt").write_text(text)
    with pytest.raises(DataError, match="time stamps"):
        open_dataset(folder)


def test_names_that_never_match_are_an_error_not_an_empty_sensor(write_folder):
    folder = write_folder()
    for path in sorted((folder / "depth").iterdir()):
        path.rename(path.with_name(f"d{path.name}"))
    with pytest.raises(DataError, match=r"d0000\.png.*0000"):
        open_dataset(folder)


def test_example_of_the_docs_is_a_valid_camera_file(write_folder):
    folder = write_folder()
    example = re.search(r"```json\n(.*?)```", DOCS.read_text(), re.S)[1]
    (folder / "camera.json").write_text(example)
    (folder / "timestamps.txt").write_text("1\n2\n3\n")
    assert open_dataset(folder).camera.width == 640
