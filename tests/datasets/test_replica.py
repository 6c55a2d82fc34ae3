from pathlib import Path

import numpy as np
import pytest
from uncle.datasets import open_dataset
from uncle.recon.core.camera import Camera

CAMERA = Camera(1200, 680, 600.0, 600.0, 599.5, 339.5)


@pytest.fixture
def scene(tmp_path: Path, room) -> Path:
    scene = tmp_path / "room0"
    poses = room.poses(3)
    for index in (0, 2):  # frame 1 was left out, but its pose was not
        color, depth = room.render(CAMERA, poses[index])
        room.write_color(scene / "results" / f"frame{index:06d}.jpg", color)
        room.write_depth(scene / "results" / f"depth{index:06d}.png", depth, 6553.5)
    lines = [" ".join(map(str, pose.ravel())) for pose in poses]
    (scene / "traj.txt").write_text("\n".join(lines) + "\n")
    return scene


def test_lands_on_the_room(scene, room):
    recording = open_dataset(scene)
    assert (recording.format, len(recording), recording.sensors) == ("replica", 2, ("depth",))
    assert recording.camera == CAMERA
    room.check(recording)
    np.testing.assert_allclose(recording.pose(1), room.poses(3)[2])


def test_saturated_depth_is_no_reading(scene, room):
    room.write_depth(scene / "results" / "depth000000.png", np.full((680, 1200), 10.0), 6553.5)
    assert not open_dataset(scene)[0].depths["depth"].any()


def test_finds_the_mesh_beside_the_scene(scene):
    (scene.parent / "room0_mesh.ply").write_text("ply")
    assert open_dataset(scene).reference_mesh == scene.parent / "room0_mesh.ply"


def test_poses_may_be_missing(scene):
    (scene / "traj.txt").unlink()
    recording = open_dataset(scene)
    assert not recording.has_poses
    assert recording[0].T_world_camera is None
