from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation, Slerp
from uncle.datasets import open_dataset
from uncle.datasets.tum import CALIBRATIONS, associate
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import DataError

START = 1305031100.0


def moving_pose(seconds: float) -> np.ndarray:
    """Constant speed and turn rate: what interpolation between two stamps must give back exactly."""
    pose = np.eye(4)
    start = Rotation.from_euler("xyz", [15, 30, 5], degrees=True)  # towards a corner of the room: no wall is frontal
    pose[:3, :3] = (start * Rotation.from_rotvec(np.array([0.3, 0.5, -0.2]) * seconds)).as_matrix()
    pose[:3, 3] = [0.4 * seconds, -0.2 * seconds, 0.1 + 0.3 * seconds]
    return pose


@pytest.fixture
def write_sequence(tmp_path: Path, room, pose_line):
    """Writes 3 frames at 0, 0.1 and 0.2 s, depth 5 ms later, poses every 30 ms, bent by the camera's own lens."""

    def write(name: str = "rgbd_dataset_freiburg1_box", camera_number: str = "1") -> Path:
        folder = tmp_path / name
        calibration = CALIBRATIONS[camera_number]
        rays = distorted_rays(calibration)
        lists: dict[str, list[str]] = {"rgb": ["# colour images"], "depth": ["# depth images"]}
        for seconds in (0.0, 0.1, 0.2):
            color, depth = room.render(calibration.camera, moving_pose(seconds), rays)
            color_name, depth_name = f"rgb/{START + seconds:.6f}.png", f"depth/{START + seconds + 0.005:.6f}.png"
            room.write_color(folder / color_name, color)
            room.write_depth(folder / depth_name, depth, 5000.0)
            lists["rgb"].append(f"{START + seconds:.6f} {color_name}")
            lists["depth"].append(f"{START + seconds + 0.005:.6f} {depth_name}")
        for stream, lines in lists.items():
            (folder / f"{stream}.txt").write_text("\n".join(lines))
        times = np.arange(-0.01, 0.3, 0.03)
        (folder / "groundtruth.txt").write_text(
            "# timestamp tx ty tz qx qy qz qw\n" + "\n".join(pose_line(START + t, moving_pose(t)) for t in times)
        )
        return folder

    return write


def distorted_rays(calibration) -> np.ndarray:
    """(H, W, 3) where each pixel of the real, bent image looks: the lens equation solved by fixed-point iteration."""
    camera = calibration.camera
    k1, k2, p1, p2, k3 = calibration.distortion or (0.0,) * 5
    u, v = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
    bent_x, bent_y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    x, y = bent_x, bent_y
    for _ in range(60):
        r2 = x**2 + y**2
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        shift_x = 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
        shift_y = p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        x, y = (bent_x - shift_x) / radial, (bent_y - shift_y) / radial
    return np.stack([x, y, np.ones_like(x)], axis=-1)


@pytest.mark.parametrize("number", ["1", "2", "3"])
def test_undistorted_frames_land_on_the_room(write_sequence, room, number):
    recording = open_dataset(write_sequence(f"rgbd_dataset_freiburg{number}_box", number))
    assert (recording.format, len(recording)) == ("tum", 3)
    assert recording.camera == CALIBRATIONS[number].camera
    assert recording.has_timestamps
    room.check(recording)


def test_undistorted_depth_is_that_of_a_pinhole(write_sequence, room):
    recording = open_dataset(write_sequence())
    _, expected = room.render(recording.camera, moving_pose(0.0))
    depth = recording.depth(0, "depth").numpy()
    errors = np.abs(depth - expected)[depth > 0]
    assert np.quantile(errors, 0.98) < 0.004  # half a pixel on the slanted walls
    assert errors.size > 0.93 * depth.size  # the lens did not see all that a pinhole of the same focal length would


def test_published_lens_coefficients():
    assert CALIBRATIONS["1"].distortion == (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    assert CALIBRATIONS["2"].distortion == (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    assert CALIBRATIONS["3"].distortion == ()


def test_without_undistortion_the_corners_would_miss_the_room(write_sequence, room):
    folder = write_sequence()
    straight = open_dataset(folder)
    (folder / "camera.json").write_text(
        '{"width": 640, "height": 480, "fx": 517.3, "fy": 516.5, "cx": 318.6, "cy": 255.3, "depth_scale": 5000}'
    )
    bent = open_dataset(folder)
    assert np.quantile(room.errors(bent, 1, "depth"), 0.9) > 1.5 * np.quantile(room.errors(straight, 1, "depth"), 0.9)


def test_poses_are_those_of_the_colour_stamps(write_sequence):
    recording = open_dataset(write_sequence())
    for index, seconds in enumerate((0.0, 0.1, 0.2)):
        np.testing.assert_allclose(recording[index].T_world_camera, moving_pose(seconds), atol=1e-6)
        assert recording[index].timestamp == pytest.approx(START + seconds, abs=1e-6)


def test_no_pose_in_a_wide_gap(write_sequence, pose_line):
    folder = write_sequence()
    times = [-0.01, 0.01, 0.05, 0.15, 0.19, 0.21]
    lines = [pose_line(START + t, moving_pose(t)) for t in times]
    lines[0] = f"{START - 0.01:.6f} nan nan nan nan nan nan nan"
    (folder / "groundtruth.txt").write_text("\n".join(lines))
    recording = open_dataset(folder)
    assert [recording.pose(index) is None for index in range(3)] == [True, True, False]
    (note,) = [note for note in recording.notes if "2 of 3 frames have no usable pose (the first: frame 0: " in note]
    assert "before the first usable pose" in note
    assert any(
        "1 of 6 poses cannot be used (the first: " in note and "line 1: its numbers" in note for note in recording.notes
    )


def test_interpolation_agrees_with_slerp():
    from uncle.datasets.poses import interpolate_poses
    from uncle.recon.core.trajectory import Trajectory

    times = np.array([0.0, 0.05, 0.1])
    rotations = Rotation.from_euler("xyz", [[0, 0, 0], [40, 10, 5], [60, -20, 90]], degrees=True)
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, :3] = rotations.as_matrix()
    poses[:, :3, 3] = [[0, 0, 0], [1, 2, 3], [2, 0, 0]]
    stamps = np.array([0.0, 0.02, 0.071, 0.1])
    found = np.array([pose.T_world_camera for pose in interpolate_poses(Trajectory(times, poses), stamps)])
    np.testing.assert_allclose(found[:, :3, :3], Slerp(times, rotations)(stamps).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(found[:, 0, 3], np.interp(stamps, times, [0, 1, 2]), atol=1e-12)


def test_association_uses_each_stamp_once_and_the_closest_first():
    color = np.array([0.00, 0.10, 0.14, 0.30])
    depth = np.array([0.01, 0.12, 0.125, 0.40])
    assert associate(color, depth, 0.04) == [(0, 0), (1, 1), (2, 2)]
    assert associate(color, depth, 0.005) == []
    assert associate(np.array([0.0, 0.02]), np.array([0.015]), 0.04) == [(1, 0)]


def test_colour_without_depth_is_left_out_and_said(write_sequence):
    folder = write_sequence()
    lines = (folder / "depth.txt").read_text().splitlines()
    (folder / "depth.txt").write_text("\n".join(lines[:2] + lines[3:]))
    recording = open_dataset(folder)
    assert [recording.timestamp(index) - START for index in range(2)] == pytest.approx([0.0, 0.2], abs=1e-6)
    assert any(note.startswith("1 of 3 colour images have no depth") for note in recording.notes)


def test_streams_of_different_recordings_name_both_ranges(write_sequence):
    folder = write_sequence()
    (folder / "depth.txt").write_text("99.5 depth/99.5.png\n")
    with pytest.raises(DataError, match=r"1305031100\.000 to 1305031100\.200.*99\.500 to 99\.500"):
        open_dataset(folder)


def test_ground_truth_of_another_recording_names_both_ranges(write_sequence, pose_line):
    folder = write_sequence()
    (folder / "groundtruth.txt").write_text(pose_line(50.0, np.eye(4)) + "\n" + pose_line(51.0, np.eye(4)))
    with pytest.raises(DataError, match=r"50\.000 to 51\.000.*remove groundtruth.txt"):
        open_dataset(folder)


def test_poses_may_be_missing(write_sequence):
    folder = write_sequence()
    (folder / "groundtruth.txt").unlink()
    assert not open_dataset(folder).has_poses


def test_bad_line_is_named(write_sequence):
    folder = write_sequence()
    (folder / "rgb.txt").write_text("# colour\n1.0 rgb/1.png\nnonsense\n")
    with pytest.raises(DataError, match=r"rgb\.txt, line 3"):
        open_dataset(folder)


def test_unknown_camera_is_guessed_and_said(write_sequence):
    recording = open_dataset(write_sequence("desk", "3"))
    assert recording.camera.fx == 525.0
    assert any("default Kinect" in note for note in recording.notes)


def test_camera_is_recognised_by_the_recording_named_in_the_lists(write_sequence):
    folder = write_sequence("desk", "3")
    text = (folder / "rgb.txt").read_text()
    (folder / "rgb.txt").write_text("# file: 'rgbd_dataset_freiburg3_desk.bag'\n" + text)
    assert open_dataset(folder).camera == CALIBRATIONS["3"].camera


def test_real_sequence_agrees_with_itself(shared_data):
    recording = open_dataset(shared_data / "tum" / "rgbd_dataset_freiburg1_xyz")
    assert len(recording) > 250
    clouds = []
    for index in (30, 150):
        frame = recording[index]
        depth = frame.depths["depth"][::3, ::3]
        points = (recording.camera.rays()[::3, ::3] * depth[..., None])[depth > 0].numpy()
        clouds.append(points @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3])
    distances, _ = cKDTree(clouds[0]).query(clouds[1], distance_upper_bound=0.1)
    overlap = np.isfinite(distances)
    assert overlap.mean() > 0.5
    assert np.median(distances[overlap]) < 0.03


@pytest.mark.parametrize("name", ["loft-fr-1st-floor", "freiburg1_copy", "my_fr2_desk"])
def test_only_names_of_tum_decide_the_camera(write_sequence, name):
    recording = open_dataset(write_sequence(name))
    assert recording.camera.fx == 525.0
    assert any("5000 depth units a metre are assumed" in note and "is that right?" in note for note in recording.notes)


def test_the_note_names_camera_and_depth_scale(write_sequence):
    notes = open_dataset(write_sequence()).notes
    assert "the camera of freiburg1 and 5000 depth units a metre are assumed, by the name" in notes


def test_depth_in_millimetres_is_questioned(write_sequence, room):
    folder = write_sequence("desk", "3")
    for path in (folder / "depth").iterdir():
        room.write_depth(path, np.full((480, 640), 1.5), 1000.0)
    assert any("median depth is 0.30 m then; with 1000 units it is 1.50 m" in n for n in open_dataset(folder).notes)


@pytest.mark.parametrize("depth_first", [False, True])
def test_associations_alone_are_enough(write_sequence, room, depth_first):
    folder = write_sequence()
    rows = [(folder / f"{name}.txt").read_text().splitlines()[1:] for name in ("rgb", "depth")]
    lines = [f"{depth} {color}" if depth_first else f"{color} {depth}" for color, depth in zip(*rows, strict=True)]
    (folder / "associations.txt").write_text("\n".join(lines))
    for name in ("rgb", "depth"):
        (folder / f"{name}.txt").unlink()
    recording = open_dataset(folder)
    assert (recording.format, len(recording)) == ("tum", 3)
    room.check(recording)


def test_lists_as_other_tools_write_them(write_sequence, room):
    folder = write_sequence()
    (folder / "rgb").rename(folder / "rgb images")
    color = (folder / "rgb.txt").read_text().replace(" rgb/", ",rgb images\\").splitlines()
    (folder / "rgb.txt").write_bytes("\r\n".join(["timestamp,filename", *color[1:]]).encode("utf-16"))
    lines = [line.split() for line in (folder / "depth.txt").read_text().splitlines()[1:]]
    (folder / "depth.txt").write_text("\n".join(f"{float(time) * 1e9:.0f} {name} 640 480" for time, name in lines))
    recording = open_dataset(folder)
    assert "time stamps of depth.txt are read as nanoseconds" in recording.notes
    room.check(recording)


def test_calibration_of_eth3d_replaces_the_camera_of_tum(write_sequence):
    folder = write_sequence("sequence", "3")
    (folder / "calibration.txt").write_text("500.5 501.5 310.25 245.75\n")
    recording = open_dataset(folder)
    assert recording.camera == Camera(640, 480, 500.5, 501.5, 310.25, 245.75)
    assert any("calibration.txt, with 5000 depth units a metre" in note for note in recording.notes)
