from pathlib import Path

import numpy as np
import pytest
from uncle.datasets import open_dataset
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import DataError

CAMERA = Camera(640, 480, 570.0, 572.0, 318.0, 243.0)


@pytest.fixture
def scene(tmp_path: Path, room) -> Path:
    scene = tmp_path / "scene0000_00"
    for index, pose in zip((0, 5, 10), room.poses(3), strict=True):
        color, _ = room.render(CAMERA.resized(1296, 968), pose)
        _, depth = room.render(CAMERA, pose)
        room.write_color(scene / "frames" / "color" / f"{index}.jpg", color)
        room.write_depth(scene / "frames" / "depth" / f"{index}.png", depth)
        room.write_matrix(scene / "frames" / "pose" / f"{index}.txt", pose)
    intrinsic = np.eye(4)
    intrinsic[:3, :3] = CAMERA.matrix
    room.write_matrix(scene / "frames" / "intrinsic" / "intrinsic_depth.txt", intrinsic)
    return scene


def test_large_colour_is_brought_to_the_depth_camera(scene, room):
    recording = open_dataset(scene)
    assert recording.format == "scannet"
    assert recording.camera == CAMERA.cropped(10)
    assert recording[0].color.shape == (460, 620, 3)
    room.check(recording)


def test_lost_cameras_are_written_as_infinite(scene, room):
    room.write_matrix(scene / "frames" / "pose" / "5.txt", np.full((4, 4), -np.inf))
    recording = open_dataset(scene)
    assert [recording.pose(index) is None for index in range(3)] == [False, True, False]


def test_typical_camera_without_intrinsics_is_said(scene):
    (scene / "frames" / "intrinsic" / "intrinsic_depth.txt").unlink()
    recording = open_dataset(scene)
    assert recording.camera.fx == pytest.approx(577.59)
    assert any("typical intrinsics" in note for note in recording.notes)


def test_broken_intrinsics_are_an_error(scene):
    (scene / "frames" / "intrinsic" / "intrinsic_depth.txt").write_text("not a matrix")
    with pytest.raises(DataError, match="intrinsic"):
        open_dataset(scene)
