import json
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.datasets import open_dataset
from uncle.datasets.calibration import CameraFile
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import DataError, FrameError

DOCS = Path(__file__).resolve().parents[2] / "docs" / "data-formats.md"

COLOR_CAMERA = {"width": 96, "height": 54, "fx": 70.0, "fy": 71.0, "cx": 50.0, "cy": 26.0}
MILLIMETRES = np.eye(4) + 25.0 * np.eye(4, k=3)


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


def test_colour_of_a_camera_of_its_own_lands_on_the_room(write_folder, room):
    folder = write_folder(sensors=("depth_tof", "depth_stereo"))
    write_poses(folder, room)
    T_color_depth = np.eye(4)
    T_color_depth[:3, 3] = [-0.05, 0.01, 0.0]
    for index, pose in enumerate(room.poses(3)):
        color, _ = room.render(Camera(**COLOR_CAMERA), pose @ np.linalg.inv(T_color_depth))
        room.write_color(folder / "color" / f"{index:04d}.png", color)
    (folder / "depth_stereo" / "0001.png").unlink()  # the other sensor stands in, as it does
    (folder / "depth_stereo" / "0002.png").write_bytes(b"")  # for an image that cannot be read
    set_camera(folder, color_camera=COLOR_CAMERA, T_color_depth=T_color_depth.tolist())
    recording = open_dataset(folder)
    for index in range(3):
        color, depth = recording.color(index).numpy(), recording.depth(index, "tof").numpy()
        expected, _ = room.render(recording.camera, room.poses(3)[index])
        assert np.median(np.abs(color.astype(int) - expected)) <= 1
        assert depth.shape == color.shape[:2]


def test_colour_of_a_camera_of_its_own_has_its_own_distortion(write_folder, room):
    folder = write_folder()
    coefficients = np.array([-0.3, 0.1, 0.0, 0.0])
    camera = Camera(**COLOR_CAMERA)
    pixels = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), -1).astype(np.float64)
    bent = cv2.undistortPoints(pixels.reshape(-1, 1, 2), camera.matrix, coefficients).reshape(pixels.shape)
    rays = np.concatenate([bent, np.ones((*bent.shape[:2], 1))], -1)
    for index, pose in enumerate(room.poses(3)):
        room.write_color(folder / "color" / f"{index:04d}.png", room.render(camera, pose, rays)[0])
    lens = COLOR_CAMERA | {"distortion": coefficients.tolist()}
    set_camera(folder, color_camera=lens, T_color_depth=np.eye(4).tolist())
    recording = open_dataset(folder)
    expected, _ = room.render(recording.camera, room.poses(1)[0])
    difference = np.abs(recording.color(0).numpy().astype(int) - expected)
    assert np.quantile(difference, 0.9) <= 3
    set_camera(folder, color_camera=COLOR_CAMERA)
    assert np.quantile(np.abs(open_dataset(folder).color(0).numpy().astype(int) - expected), 0.9) > 6


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


POSE_FORMATS = {
    "poses.kitti": lambda poses: "\n".join(" ".join(map(str, pose[:3].ravel())) for pose in poses),
    "poses.tum": lambda poses: "\n".join(f"{index} {vectors(pose)}" for index, pose in enumerate(poses)),
    "trajectory.log": lambda poses: "\n".join(
        f"{index} {index} 3\n" + "\n".join(" ".join(map(str, row)) for row in pose) for index, pose in enumerate(poses)
    ),
    "groundtruth.csv": lambda poses: (
        "#timestamp, p_x [m], p_y [m], p_z [m], q_x [], q_y [], q_z [], q_w []\n"
        + "\n".join(f"{index},{vectors(pose).replace(' ', ',')}" for index, pose in enumerate(poses))
    ),
    "poses.g2o": lambda poses: "\n".join(
        f"VERTEX_SE3:QUAT {index} {vectors(pose)}" for index, pose in enumerate(poses)
    ),
}


def vectors(pose):
    return " ".join(map(str, [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]))


@pytest.mark.parametrize("name", POSE_FORMATS)
def test_poses_in_formats_of_trajectory_tools(write_folder, room, name):
    folder, poses = write_folder(), room.poses(3)
    (folder / name).write_text(POSE_FORMATS[name](poses))
    recording = open_dataset(folder)
    np.testing.assert_allclose([recording.pose(index) for index in range(3)], poses, atol=1e-6)


def test_of_two_files_of_poses_the_one_that_is_not_read_is_named(write_folder, room):
    folder, poses = write_folder(), room.poses(3)
    (folder / "poses.tum").write_text(POSE_FORMATS["poses.tum"](poses))
    (folder / "trajectory.log").write_text(POSE_FORMATS["trajectory.log"](poses[::-1]))
    recording = open_dataset(folder)
    np.testing.assert_allclose(recording.pose(0), poses[0], atol=1e-6)
    assert "poses are those of poses.tum; trajectory.log is not read" in recording.notes


def test_the_true_surface_may_be_any_mesh_file(write_folder, box_room):
    folder = write_folder()
    box_room.mesh().save(folder / "mesh_gt.obj")
    assert open_dataset(folder).reference_mesh == folder / "mesh_gt.obj"


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
        ({"color_camera": COLOR_CAMERA}, "T_color_depth is missing"),
        ({"T_color_depth": np.eye(4).tolist()}, "color_camera is missing"),
        ({"color_camera": COLOR_CAMERA | {"fx": 0}, "T_color_depth": np.eye(4).tolist()}, r"color_camera\.fx"),
        ({"color_camera": COLOR_CAMERA | {"distortion": [1]}, "T_color_depth": np.eye(4).tolist()}, "k1, k2, p1, p2"),
        ({"color_camera": COLOR_CAMERA, "T_color_depth": np.eye(3).tolist()}, "T_color_depth: expected 4 rows of 4"),
        ({"color_camera": COLOR_CAMERA, "T_color_depth": np.diag([1, 1, -1, 1]).tolist()}, "T_color_depth: expected"),
        ({"color_camera": COLOR_CAMERA, "T_color_depth": MILLIMETRES.tolist()}, "T_color_depth: its translation"),
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
    for path, number in zip(sorted((folder / "depth").iterdir()), (7, 8, 9), strict=True):
        path.rename(path.with_name(f"d{number}.png"))
    with pytest.raises(DataError, match=r"d7\.png.*0000"):
        open_dataset(folder)


@pytest.mark.parametrize("number", [0, 1])
def test_example_of_the_docs_is_a_valid_camera_file(write_folder, number):
    folder = write_folder()
    example = re.findall(r"```json\n(.*?)```", DOCS.read_text(), re.DOTALL)[number]
    (folder / "camera.json").write_text(example)
    assert CameraFile.load(folder / "camera.json").width == 640


def test_images_and_poses_match_by_number(write_folder, room, pose_line):
    folder = write_folder(sensors=("depth_tof",))
    for index in (2, 1, 0):
        (folder / f"color/{index:04d}.png").rename(folder / f"color/Bild {index + 9}.PNG")
        (folder / f"depth_tof/{index:04d}.png").rename(folder / f"depth_tof/depth_{index + 9:06d}.png")
    poses = room.poses(3)
    (folder / "poses.txt").write_text("\n".join(pose_line(index + 9, poses[index]) for index in (2, 0, 1)))
    recording = open_dataset(folder)
    assert (len(recording), recording.notes) == (3, ())
    room.check(recording, "tof")


def test_images_without_a_partner_and_twins_are_noted(write_folder):
    folder = write_folder()
    (folder / "color/0001.png").unlink()
    (folder / "color/0002.jpg").write_bytes((folder / "color/0002.png").read_bytes())
    notes = open_dataset(folder).notes
    assert any(
        "1 images of" in note and note.endswith("depth belong to no frame (the first: 0001.png)") for note in notes
    )
    assert any("0002.jpg" in note and "not used" in note for note in notes)


@pytest.mark.parametrize(
    "text",
    ["10\r\n10,5\r\n11\r\n", "\ufeff10000\n10500\n11000\n", "2 11\n0 10\n1 10.5\n",
     "0002.png;11\n0000.png;10\n0001.png;10,5\n", "10000000000\n10500000000\n11000000000"],
)  # fmt: skip
def test_time_stamps_of_any_unit_and_order(write_folder, text):
    folder = write_folder()
    (folder / "timestamps.txt").write_text(text)
    recording = open_dataset(folder)
    assert [recording.timestamp(index) for index in range(3)] == pytest.approx([10.0, 10.5, 11.0])


def test_camera_of_another_tool_and_of_another_size(write_folder, room):
    folder = write_folder()
    write_poses(folder, room)
    (folder / "camera.json").unlink()
    (folder / "camera-intrinsics.txt").write_text("50 0 30\n0 52 25\n0 0 1\n")
    room.check(open_dataset(folder))
    (folder / "camera-intrinsics.txt").unlink()
    stated = {"width": 128, "height": 96, "fx": 100, "fy": 104, "cx": 60.5, "cy": 50.5}
    (folder / "camera.json").write_text(json.dumps(stated))
    recording = open_dataset(folder)
    room.check(recording)
    assert any("scaled by 0.5" in note for note in recording.notes)


def test_without_a_camera_file_the_message_has_one_to_fill_in(write_folder):
    folder = write_folder()
    (folder / "camera.json").unlink()
    with pytest.raises(DataError, match=r'"width": 64, "height": 48, "fx": \?.*"depth_scale": \?'):
        open_dataset(folder)


@pytest.mark.parametrize("model", ["rational_polynomial", "fisheye"])
def test_images_of_a_strong_lens_land_on_the_room(write_folder, room, model):
    folder = write_folder()
    write_poses(folder, room)
    camera = Camera(64, 48, 50.0, 52.0, 30.0, 25.0)
    pixels = np.stack(np.meshgrid(np.arange(64), np.arange(48)), -1).astype(np.float64)
    values = np.array([0.05, -0.02, 0.01, 0.0] if model == "fisheye" else [0.6, -0.1, 0, 0, 0.02, 0.05, 0.02, 0.01])
    undistort = cv2.fisheye.undistortPoints if model == "fisheye" else cv2.undistortPoints
    bent = undistort(pixels.reshape(-1, 1, 2), camera.matrix, values).reshape(pixels.shape)
    rays = np.concatenate([bent, np.ones((48, 64, 1))], -1)
    for index, pose in enumerate(room.poses(3)):
        color, depth = room.render(camera, pose, rays)
        room.write_color(folder / f"color/{index:04d}.png", color)
        room.write_depth(folder / f"depth/{index:04d}.png", depth)
    set_camera(folder, distortion=values.tolist(), distortion_model=model)
    recording = open_dataset(folder)
    errors = np.concatenate([room.errors(recording, index, "depth") for index in range(3)])
    assert np.median(errors) < 0.03  # depth is resampled to the nearest of 64x48 pixels
    set_camera(folder, distortion=[], distortion_model="opencv")
    assert np.median(np.concatenate([room.errors(open_dataset(folder), i, "depth") for i in range(3)])) > 0.03
