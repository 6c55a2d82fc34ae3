"""Depth errors of a box room whose walls are moved by a known distance."""

import numpy as np
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.mesh_raycaster import Surface, sample_surface
from uncle.recon.evaluation.depth_metrics import (
    NEW_VIEW_PARAMETERS,
    ViewSettings,
    centre_box,
    held_out_depth,
    novel_view_depth,
    pose_towards,
    sample_views,
)
from uncle.recon.evaluation.mesh_metrics import near_to

VIEWS = ViewSettings(views=20)
PAPER_CAMERA = NEW_VIEW_PARAMETERS["paper"].camera
EMPTY = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))


def test_rendered_depth_is_the_analytic_one(box_room):
    pose = box_room.pose(0.4)
    np.testing.assert_allclose(Surface(box_room.mesh()).depth(box_room.camera, pose), box_room.depth(pose), atol=1e-4)


def test_same_mesh_has_no_error(box_room):
    metrics = novel_view_depth(box_room.mesh(), box_room.mesh(), VIEWS)
    assert (metrics.l1_all_m, metrics.l1_rendered_m, metrics.completeness) == (0.0, 0.0, 1.0)
    assert metrics.views == 20
    assert not metrics.culled


def test_moved_walls_are_off_by_the_move_over_the_cosine(box_room):
    metrics = novel_view_depth(box_room.mesh(grow_m=0.01), box_room.mesh(), VIEWS)
    assert 0.01 <= metrics.l1_all_m < 0.02  # never less than along the normal
    assert metrics.l1_all_m == metrics.l1_rendered_m


def test_missing_wall_counts_with_its_depth_in_a_and_not_in_b(box_room):
    mesh = box_room.mesh()
    open_room = Mesh(mesh.vertices, mesh.faces[:-2])  # no wall at x = 4
    metrics = novel_view_depth(open_room, mesh, VIEWS)
    assert metrics.l1_rendered_m == pytest.approx(0.0, abs=1e-6)
    assert 0.5 < metrics.completeness < 1.0
    assert 0.3 * (1 - metrics.completeness) < metrics.l1_all_m < 5.0 * (1 - metrics.completeness)


def test_unseen_parts_are_not_asked_for(box_room):
    mesh = box_room.mesh()
    open_room = Mesh(mesh.vertices, mesh.faces[:-2])
    seen = sample_surface(open_room, 200_000, np.random.default_rng(0))
    metrics = novel_view_depth(open_room, mesh, VIEWS, seen)
    assert metrics.culled
    assert metrics.completeness > 0.99  # the rim of the missing wall is near what was seen
    assert metrics.l1_all_m < 0.02


def test_empty_mesh_is_missing_everywhere(box_room):
    metrics = novel_view_depth(EMPTY, box_room.mesh(), VIEWS)
    assert metrics.l1_rendered_m is None
    assert metrics.completeness == 0.0
    assert 0.5 < metrics.l1_all_m < 3.0  # the mean depth of the room itself


def test_views_are_repeatable_inside_and_clear_of_walls(box_room):
    surface = Surface(box_room.mesh())
    poses = sample_views(box_room.mesh(), surface, VIEWS)
    np.testing.assert_array_equal(poses, sample_views(box_room.mesh(), surface, VIEWS))
    centres = np.array(poses)[:, :3, 3]
    assert (centres > 0.2).all()
    assert (centres < np.array([4.0, 3.0, 2.5]) - 0.2).all()
    other = sample_views(box_room.mesh(), surface, ViewSettings(views=20, seed=1))
    assert not np.allclose(np.array(other)[:, :3, 3], centres)


def test_box_of_centres_is_the_published_one(box_room):
    center, axes, half = centre_box(box_room.mesh(), NEW_VIEW_PARAMETERS["paper"])
    np.testing.assert_allclose(center, [2.0, 1.5, 1.65], atol=1e-6)
    np.testing.assert_allclose(half * 2, [0.3 * 2.5, 0.7 * 3.0, 0.7 * 4.0], atol=1e-5)
    np.testing.assert_allclose(np.abs(axes), [[0, 0, 1], [0, 1, 0], [1, 0, 0]], atol=1e-6)


def test_paper_protocol_compares_every_pixel_of_views_without_unseen_parts(box_room):
    settings = ViewSettings(views=2, protocol="paper")
    metrics = novel_view_depth(box_room.mesh(0.01), box_room.mesh(), settings)
    assert (metrics.width, metrics.height, metrics.views) == (500, 500, 2)
    assert settings.parameters.camera == PAPER_CAMERA
    assert 0.01 <= metrics.l1_all_m < 0.02
    mesh = box_room.mesh()
    seen = sample_surface(Mesh(mesh.vertices, mesh.faces[:-2]), 200_000, np.random.default_rng(0))
    for pose in sample_views(mesh, Surface(mesh), ViewSettings(views=3, protocol="paper"), near_to(seen)):
        assert _wall_share(box_room, pose) < 0.01


def test_of_the_papers_views_each_weighs_the_same(box_room):
    """A view without the missing wall has no error; one that shows little of the rest must count as much."""
    mesh, reference = box_room.mesh(0.01), box_room.mesh()
    half = Mesh(mesh.vertices, mesh.faces[:2])  # one wall
    settings = ViewSettings(views=4, protocol="paper")
    metrics = novel_view_depth(half, reference, settings)
    target, found = Surface(reference), Surface(half)
    means, all_pixels = [], []
    for pose in sample_views(reference, target, settings):
        difference = np.abs(found.depth(PAPER_CAMERA, pose) - target.depth(PAPER_CAMERA, pose))
        rendered = found.depth(PAPER_CAMERA, pose) > 0
        means += [difference[rendered].mean(dtype=np.float64)] if rendered.any() else []
        all_pixels.append(difference.mean(dtype=np.float64))
    assert len(means) > 0
    assert metrics.l1_rendered_m == pytest.approx(np.mean(means), rel=1e-5)
    assert metrics.l1_all_m == pytest.approx(np.mean(all_pixels), rel=1e-5)


def test_the_papers_views_may_look_out_of_a_window_and_from_anywhere_in_the_box(box_room):
    mesh = box_room.mesh()
    window = Mesh(mesh.vertices, mesh.faces[:-2])
    standard, paper = (
        sample_views(window, Surface(window), ViewSettings(views=60, protocol=name)) for name in ("standard", "paper")
    )
    holes = [
        max((Surface(window).depth(PAPER_CAMERA, p)[::10, ::10] == 0).mean() for p in part)
        for part in (standard, paper)
    ]
    assert holes[0] < 0.25
    assert holes[1] > 0.4


def _wall_share(box_room, pose) -> float:
    """Share of the image that shows the wall at x = 4."""
    depth = Surface(box_room.mesh()).depth(PAPER_CAMERA, pose)
    points = (PAPER_CAMERA.rays().numpy() * depth[..., None]) @ pose[:3, :3].T + pose[:3, 3]
    return float((points[..., 0] > 3.999).mean())


def test_open_scene_without_an_inside_is_an_error():
    plate = Mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.01]], np.float32), np.array([[0, 1, 2]], np.int32))
    roof = Mesh(
        np.vstack([plate.vertices, [[1, 1, 0.3]]]).astype(np.float32), np.array([[0, 1, 2], [1, 3, 2]], np.int32)
    )
    for scene in (plate, roof):
        with pytest.raises(DataError, match="room"):
            novel_view_depth(scene, scene, ViewSettings(views=2))


def test_a_pose_towards_a_point_is_a_right_handed_frame_with_its_axis_there():
    T = pose_towards(np.array([1.0, 2.0, 3.0]), np.array([4.0, 2.0, 3.0]))
    np.testing.assert_allclose(T[:3, :3], [[0, 0, 1], [-1, 0, 0], [0, -1, 0]], atol=1e-12)
    straight_up = pose_towards(np.zeros(3), np.array([0.0, 0.0, 1.0]))[:3, :3]
    np.testing.assert_allclose(straight_up @ straight_up.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(straight_up) == pytest.approx(1.0)


def test_held_out_depth_of_a_wall_behind_the_readings(box_room):
    mesh = box_room.mesh()
    pose = box_room.pose(0.0)
    half = np.where(np.arange(160) < 80, box_room.depth(pose) - 0.03, 0.0)
    metrics = held_out_depth(mesh, box_room.camera, [(pose, half)] * 2, "sl")
    assert metrics.l1_m == pytest.approx(0.03, abs=1e-5)
    assert metrics.median_m == pytest.approx(0.03, abs=1e-5)
    assert (metrics.frames, metrics.measurements, metrics.completeness) == (2, 2 * 80 * 120, 1.0)


def test_held_out_depth_states_what_the_mesh_lacks(box_room):
    mesh = box_room.mesh()
    frames = [(box_room.pose(0.0), box_room.depth(box_room.pose(0.0)))]
    partial = held_out_depth(Mesh(mesh.vertices, mesh.faces[:-2]), box_room.camera, frames, "sl")
    assert 0.0 < partial.completeness < 0.8
    assert partial.l1_m == pytest.approx(0.0, abs=1e-5)
    nothing = held_out_depth(EMPTY, box_room.camera, frames, "sl")
    assert (nothing.l1_m, nothing.median_m, nothing.completeness) == (None, None, 0.0)
    unread = held_out_depth(mesh, box_room.camera, [], "sl")
    assert (unread.l1_m, unread.frames, unread.measurements) == (None, 0, 0)
