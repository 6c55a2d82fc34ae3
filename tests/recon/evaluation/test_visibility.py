"""What the cameras saw of a box room."""

import json

import numpy as np
import open3d as o3d
import pytest
import torch
from uncle.recon.core.camera import project_into
from uncle.recon.core.errors import DataError, RunError
from uncle.recon.core.mesh import PointCloud
from uncle.recon.core.mesh_raycaster import Surface
from uncle.recon.evaluation.visibility import Visibility, VisibilityParameters, voxel_means
from uncle.recon.run.directory import RunDirectory


def test_all_around_sees_the_walls_and_nothing_behind_them(make_box_run):
    visibility = Visibility.of_run(make_box_run())
    points = np.array([[2.0, 1.5, 1.2], [3.99, 1.5, 1.2], [4.15, 1.5, 1.2], [4.25, 1.5, 1.2], [2.0, -0.5, 1.2]])
    np.testing.assert_array_equal(visibility.is_visible(points), [True, True, True, False, False])


def test_one_view_sees_its_side_only(make_box_run):
    visibility = Visibility.of_run(make_box_run(angles=np.array([0.0])))
    points = np.array([[3.9, 1.5, 1.2], [0.1, 1.5, 1.2], [3.9, 1.5, 2.4]])
    np.testing.assert_array_equal(visibility.is_visible(points), [True, False, True])
    reference = visibility.reference_points(None)
    assert reference[:, 0].min() > 1.6  # the camera stands at x = 1.6 and looks along x


@pytest.mark.parametrize("sensors", [("gt", "noisy"), ("noisy",)])
def test_reference_points_lie_on_the_reference_whatever_the_sensor(make_box_run, box_room, sensors):
    visibility = Visibility.of_run(make_box_run(sensors))
    assert visibility.has_true_depth == ("gt" in sensors)
    points = visibility.reference_points(box_room.mesh())
    assert len(points) > 2000
    distance = Surface(box_room.mesh()).distance(points)
    assert np.quantile(distance, 0.9) < (0.002 if "gt" in sensors else 1e-4)  # depth is stored in whole millimetres
    assert distance.max() < 0.008  # a mean over a corner of the room lies off both walls, by half a voxel at most


def test_of_a_point_cloud_the_visible_points_are_the_reference(make_box_run):
    visibility = Visibility.of_run(make_box_run(("noisy",), angles=np.array([0.0])))
    cloud = PointCloud(np.array([[3.9, 1.5, 1.2], [0.1, 1.5, 1.2], [3.9, 1.5, 2.4], [2, 1.5, 1.3]], np.float32))
    points = visibility.reference_points(cloud)  # the second is behind the camera
    np.testing.assert_allclose(points[np.argsort(points[:, 0] + points[:, 2])], cloud.points[[3, 0, 2]], atol=1e-6)


def test_ground_truth_alone_decides_where_it_exists(make_box_run):
    assert Visibility.of_run(make_box_run(("gt", "noisy"))).sensors == ("gt",)
    assert Visibility.of_run(make_box_run(("noisy", "other"))).sensors == ("noisy", "other")


def test_many_frames_are_thinned_evenly(make_box_run):
    run = make_box_run(angles=np.linspace(0, 6, 80))
    assert Visibility.of_run(run).indices == tuple(range(0, 80, 2))
    assert Visibility.of_run(run, VisibilityParameters(max_frames=20)).indices == tuple(range(0, 80, 4))


def test_a_run_without_poses_cannot_cull(make_box_run):
    run = make_box_run()
    text = run.frames_path.read_text()
    rows = [{**row, "T_world_camera": None} for row in json.loads(text)]
    run.frames_path.write_text(json.dumps(rows))
    with pytest.raises(DataError, match="no camera poses"):
        Visibility.of_run(run)


def test_no_run_is_an_error_that_names_the_command(tmp_path):
    with pytest.raises(RunError, match="uncle preprocess"):
        Visibility.of_run(RunDirectory(tmp_path))


def test_projection_agrees_with_the_camera(box_room):
    T = box_room.pose(0.7)
    points = np.random.default_rng(0).uniform([0, 0, 0], [4, 3, 2.5], (500, 3))
    inside, pixels, z = project_into(points, box_room.camera, T)
    u, v, depth = box_room.camera.project(torch.from_numpy((points[inside] - T[:3, 3]) @ T[:3, :3]))
    np.testing.assert_array_equal(pixels, np.rint(torch.stack([u, v], 1).numpy()).astype(int))
    np.testing.assert_allclose(z, depth)
    assert 0 < len(inside) < 500


def test_voxel_means_keeps_one_point_per_voxel():
    points = np.random.default_rng(0).uniform(-1, 1, (2000, 3))
    means = voxel_means(points, 0.3)
    oracle = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)).voxel_down_sample(0.3)
    np.testing.assert_allclose(_sorted(means), _sorted(np.asarray(oracle.points)), atol=1e-12)
    assert voxel_means(np.zeros((0, 3)), 1.0).shape == (0, 3)


def _sorted(points):
    return points[np.lexsort(points.T)]
