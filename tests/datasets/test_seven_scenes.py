from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial import cKDTree
from uncle.datasets import open_dataset
from uncle.recon.camera import Camera

CAMERA = Camera(640, 480, 585.0, 585.0, 320.0, 240.0)


@pytest.fixture(params=[".png", ".jpg"])
def sequence(request, tmp_path: Path, room) -> Path:
    sequence = tmp_path / "chess" / "seq-01"
    for index, pose in enumerate(room.poses(2)):
        color, depth = room.render(CAMERA, pose)
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


@pytest.mark.parametrize("broken", ["nan", "inf", "scale", "mirror", "words", "short"])
def test_frame_with_a_broken_pose_has_none(sequence, room, broken):
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
    assert "1 of 2 frames have no usable pose (the first: frame 1)" in recording.notes


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
