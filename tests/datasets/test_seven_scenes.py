from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from uncle.datasets import open_dataset
from uncle.datasets.registration import ColorRegistration, filled_inverse_depth
from uncle.datasets.seven_scenes import KINECT
from uncle.recon.core.camera import Camera

CAMERA = Camera(640, 480, 585.0, 585.0, 320.0, 240.0)


@pytest.fixture(params=[".png", ".jpg"])
def sequence(request, tmp_path: Path, room) -> Path:
    sequence = tmp_path / "chess" / "seq-01"
    for index, pose in enumerate(room.poses(2)):
        color, _ = room.render(KINECT.color_camera, pose @ np.linalg.inv(KINECT.T_color_depth))
        _, depth = room.render(CAMERA, pose)
        room.write_color(sequence / f"frame-{index:06d}.color{request.param}", color)
        room.write_depth(sequence / f"frame-{index:06d}.depth.png", depth)
        room.write_matrix(sequence / f"frame-{index:06d}.pose.txt", pose)
    return sequence


def test_lands_on_the_room(sequence, room):
    recording = open_dataset(sequence.parent)
    assert (recording.format, recording.name, len(recording)) == ("7scenes", "chess-seq-01", 2)
    assert recording.camera == CAMERA
    room.check(recording)


def test_both_marks_of_a_hole_are_no_reading(sequence):
    path = sequence / "frame-000000.depth.png"
    values = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    values[:100], values[100:200] = 0, 65535
    cv2.imwrite(str(path), values)
    depth = open_dataset(sequence)[0].depths["depth"]
    assert not depth[:200].any()
    assert (depth[200:] > 0).all()


@pytest.mark.parametrize(
    ("broken", "reason"),
    [
        ("nan", "not finite"),
        ("inf", "not finite"),
        ("scale", "a scale of 2;"),
        ("mirror", "mirror image"),
        ("words", "is no number"),
        ("short", "found 3 numbers"),
    ],
)
def test_frame_with_a_broken_pose_has_none_and_the_note_names_the_reason(sequence, room, broken, reason):
    pose = room.poses(2)[1]
    matrices = {
        "nan": pose * np.nan,
        "inf": np.full((4, 4), -np.inf),
        "scale": np.diag([2.0, 2, 2, 1]),
        "mirror": np.diag([1.0, 1, -1, 1]),
        "short": np.eye(3),
    }
    path = sequence / "frame-000001.pose.txt"
    if broken in matrices:
        np.savetxt(path, matrices[broken])
    else:
        path.write_text("lost")
    recording = open_dataset(sequence)
    assert recording[1].T_world_camera is None
    assert recording[0].T_world_camera is not None
    assert recording.has_poses
    (note,) = [note for note in recording.notes if "usable pose" in note]
    assert note.startswith("1 of 2 frames have no usable pose (the first: frame 1: ")
    assert "frame-000001.pose.txt" in note
    assert reason in note


def test_missing_depth_is_an_empty_image_and_a_note(sequence):
    (sequence / "frame-000001.depth.png").unlink()
    recording = open_dataset(sequence)
    assert not recording[1].depths["depth"].any()
    assert "sensor depth has no image in 1 of 2 frames" in recording.notes


def test_real_kitchen_agrees_with_itself(shared_data):
    recording = open_dataset(shared_data / "7scenes" / "redkitchen")
    assert len(recording) == 300
    first, second = (_cloud(recording, index) for index in (50, 250))
    distances, _ = cKDTree(first).query(second, distance_upper_bound=0.1)
    overlap = np.isfinite(distances)
    assert overlap.mean() > 0.3
    assert np.median(distances[overlap]) < 0.03


def _cloud(recording, index: int) -> np.ndarray:
    frame = recording[index]
    depth = frame.depths["depth"][::3, ::3]
    points = (recording.camera.rays()[::3, ::3] * depth[..., None])[depth > 0].numpy()
    return points @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3]


def test_colour_is_registered_unless_a_camera_file_says_otherwise(sequence):
    default = open_dataset(sequence)
    assert any("registered to depth by a typical calibration" in note for note in default.notes)
    assert default.registration_sigma_px == 0.0
    camera = '{"width": 640, "height": 480, "fx": 585, "fy": 585, "cx": 320, "cy": 240'
    (sequence / "camera.json").write_text(camera + ', "registration_sigma_px": 0.7}')
    assert open_dataset(sequence).registration_sigma_px == 0.7
    (sequence / "camera.json").write_text(camera + "}")
    as_it_is = open_dataset(sequence)
    assert as_it_is.registration_sigma_px == 0.0
    assert any("taken as registered to depth" in note for note in as_it_is.notes)
    raw = cv2.imread(str(next(sequence.glob("frame-000000.color.*"))))[..., ::-1]
    np.testing.assert_array_equal(as_it_is.color(0).numpy(), raw)
    assert np.abs(default.color(0).numpy().astype(int) - raw).mean() > 1


def test_frame_without_depth_still_has_its_colour(sequence, room):
    (sequence / "frame-000001.depth.png").unlink()
    recording = open_dataset(sequence)
    expected, _ = room.render(CAMERA, room.poses(2)[1])
    raw = cv2.imread(str(next(sequence.glob("frame-000001.color.*"))))[..., ::-1]
    error, unregistered = (np.abs(c.astype(int) - expected).mean() for c in (recording.color(1).numpy(), raw))
    assert error < 0.5 * unregistered


def test_real_kitchen_colour_changes_where_depth_does(shared_data):
    folder = shared_data / "7scenes" / "redkitchen"
    recording = open_dataset(folder)
    wrong_way = ColorRegistration(KINECT.color_camera, np.linalg.inv(KINECT.T_color_depth), CAMERA)
    scores = []
    for index in range(0, 300, 25):
        depth = recording.depth(index, "depth").numpy()
        raw = cv2.imread(str(folder / "seq-01" / f"frame-{index:06d}.color.jpg"))[..., ::-1].copy()
        colors = raw, wrong_way(raw, depth), recording.color(index).numpy()
        scores.append([_edge_score(color, depth) for color in colors])
    unregistered, inverse, registered = np.mean(scores, axis=0)  # 1.1, 1.2 (which the warp alone makes), 2.8
    assert registered > 2 * max(unregistered, inverse)


def _edge_score(color: np.ndarray, depth: np.ndarray) -> float:
    """Mean gradient of grey at readings with something a tenth farther beside them, over that of the whole image."""
    grey = cv2.GaussianBlur(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.0)
    gradient = np.hypot(cv2.Sobel(grey, -1, 1, 0), cv2.Sobel(grey, -1, 0, 1))[40:-40, 60:-60]
    filled = 1 / filled_inverse_depth(depth)
    rim = (cv2.dilate(filled, np.ones((3, 3))) > 1.1 * filled) & (depth > 0)
    return float(gradient[rim[40:-40, 60:-60]].mean() / gradient.mean())


INTRINSIC = "580 0 321 0 0 581 241 0 0 0 1 0 0 0 0 1"
INFO = f"""m_colorWidth = 640
m_colorHeight = 480
m_depthWidth = 640
m_depthHeight = 480
m_depthShift = 1000
m_calibrationColorIntrinsic = {INTRINSIC}
m_calibrationDepthIntrinsic = {INTRINSIC}
"""


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("../camera-intrinsics.txt", "580\t0\t321\n0\t581\t241\n0\t0\t1\n"),
        ("camera-intrinsics.txt", "580 0 321\n0 581 241\n0 0 1\n"),
        ("info.txt", INFO),
    ],
    ids=["3DMatch scene", "3DMatch sequence", "BundleFusion"],
)
def test_other_data_sets_of_this_layout_keep_their_camera_and_colour(sequence, name, text):
    (sequence / name).write_text(text)
    recording = open_dataset(sequence)
    assert recording.camera == Camera(640, 480, 580.0, 581.0, 321.0, 241.0)
    assert recording.registration_sigma_px == 0.0
    raw = cv2.imread(str(next(sequence.glob("frame-000000.color.*"))))[..., ::-1]
    np.testing.assert_array_equal(recording.color(0).numpy(), raw)
