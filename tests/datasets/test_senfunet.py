from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.datasets import open_dataset
from uncle.recon.core.camera import Camera

FOLDERS = {"gt": "left_depth_gt", "sl": "left_depth_noise_1.0", "tof": "left_depth_noise_5.0", "sgm": "left_sgm_depth"}


@pytest.fixture
def scene(tmp_path: Path, room) -> Path:
    camera = Camera(64, 64, 32.0, 32.0, 31.5, 31.5)
    for index, pose in zip((0, 2, 10), room.poses(3), strict=True):
        color, depth = room.render(camera, pose)
        trajectory = tmp_path / "office" / "1"
        room.write_color(trajectory / "left_rgb" / f"{index}.png", color)
        for folder in FOLDERS.values():
            room.write_depth(trajectory / folder / f"{index}.png", depth)
        y_up_from_z_up = np.eye(4)
        y_up_from_z_up[:3, :3] = Rotation.from_euler("x", -90, degrees=True).as_matrix()
        opengl = y_up_from_z_up @ pose @ np.diag([1.0, -1, -1, 1])
        room.write_matrix(trajectory / "left_camera_matrix" / f"{index}.txt", opengl)
    return tmp_path / "office"


def test_all_sensors_land_on_the_room(scene, room):
    recording = open_dataset(scene)
    assert recording.format == "senfunet"
    assert recording.sensors == ("gt", "sl", "tof", "sgm")
    assert recording.has_poses
    assert not recording.has_timestamps
    for sensor in recording.sensors:
        room.check(recording, sensor)


def test_frames_are_in_numeric_order_and_poses_exact(scene, room):
    recording = open_dataset(scene / "1")
    assert [recording.timestamp(index) for index in range(3)] == [0.0, 1.0, 2.0]
    for index, pose in enumerate(room.poses(3)):
        np.testing.assert_allclose(recording.pose(index), pose, atol=1e-9)


def test_other_depth_folders_become_sensors_and_other_folders_do_not(scene, room):
    for name in ("left_lidar_depth", "left_depth_noise_2.0", "left_routing_confidence", "right_depth_gt"):
        room.write_depth(scene / "1" / name / "0.png", np.ones((64, 64)))
    recording = open_dataset(scene)
    assert recording.sensors == ("gt", "sl", "tof", "sgm", "noise_2.0", "lidar")
    frame = recording[1]
    assert not frame.depths["lidar"].any()
    assert "sensor lidar has no image in 2 of 3 frames" in recording.notes


def test_finds_the_mesh_of_the_scene(scene):
    assert open_dataset(scene).reference_mesh is None
    (scene / "mesh_gt.ply").write_text("ply")
    assert open_dataset(scene / "1").reference_mesh == scene / "mesh_gt.ply"


def test_second_trajectory_is_mentioned_and_can_be_named(scene):
    (scene / "2" / "left_rgb").mkdir(parents=True)
    recording = open_dataset(scene)
    assert recording.name == "office-1"
    assert any("2 sequences (1, 2)" in note for note in recording.notes)


def test_camera_file_overrides_the_rendered_camera(scene):
    (scene / "1" / "camera.json").write_text('{"width": 64, "height": 64, "fx": 40, "fy": 41, "cx": 30, "cy": 33}')
    assert open_dataset(scene).camera == Camera(64, 64, 40, 41, 30, 33)


def test_real_room_lies_on_its_mesh(shared_data):
    import open3d as o3d

    recording = open_dataset(shared_data / "rooms" / "living_room")
    assert set(recording.sensors) == {"gt", "sl", "sgm", "psmnet"}
    mesh = o3d.io.read_triangle_mesh(str(recording.reference_mesh))
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh))
    for index in (0, 60, 129):
        frame = recording[index]
        depth = frame.depths["gt"]
        points = (recording.camera.rays() * depth[..., None])[depth > 0][::37].numpy()
        points = points @ frame.T_world_camera[:3, :3].T + frame.T_world_camera[:3, 3]
        distances = scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()
        assert np.median(distances) < 0.0005  # half a millimetre: what rounding to millimetres leaves
