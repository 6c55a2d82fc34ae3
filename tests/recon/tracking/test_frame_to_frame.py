"""Two views of a room whose every distance is known, against each other."""

import numpy as np
import pytest
from uncle.recon.core.camera import Camera
from uncle.recon.core.se3 import apply_motion, inverse, motion_between, rotation_angle
from uncle.recon.tracking.frame_to_frame import SurfaceView, align_views, view_residuals, view_term
from uncle.recon.tracking.pose_estimation import minimise

CORNER = 0.785
OFF = np.array([0.02, -0.015, 0.025, 0.008, -0.01, 0.006])
CAMERA = Camera(160, 120, 90.0, 90.0, 79.5, 59.5)


def view(room, pose, sigma_m: float = 0.01) -> SurfaceView:
    points = room.camera.rays().numpy() * room.depth(pose)[..., None]
    return SurfaceView(room.camera, points, room.normals(pose).astype(float), np.full(points.shape[:2], sigma_m))


def plane(depth_m: float = 1.5) -> SurfaceView:
    points = CAMERA.rays().numpy() * depth_m
    return SurfaceView(CAMERA, points, np.broadcast_to([0.0, 0.0, -1.0], points.shape), np.full((120, 160), 0.01))


@pytest.fixture(scope="module")
def pair(box_room) -> tuple[SurfaceView, SurfaceView, np.ndarray]:
    """Two views of a corner of the room, and T_target_source."""
    target, source = box_room.pose(CORNER - 0.1), box_room.pose(CORNER + 0.1)
    return view(box_room, target), view(box_room, source), inverse(target) @ source


def test_residuals_vanish_at_the_truth(pair):
    target, source, true = pair
    r, _ = view_residuals(target, source, true)
    assert len(r) > 0.7 * source.valid.sum()
    assert np.quantile(np.abs(r), 0.95) < 1e-3


def test_a_residual_is_the_distance_in_sigmas_of_both():
    target, source = plane(), plane()
    r, jacobian = view_residuals(target, source, apply_motion(np.eye(4), np.array([0.0, 0.0, 0.02, 0.0, 0.0, 0.0])))
    np.testing.assert_allclose(r, -0.02 / np.hypot(0.01, 0.01), rtol=1e-5)
    np.testing.assert_allclose(jacobian[:, :3], np.tile([0.0, 0.0, -1 / np.hypot(0.01, 0.01)], (len(r), 1)), atol=1e-9)


def test_jacobian_against_differences(pair):
    target, source, true = pair
    T = apply_motion(true, 0.3 * OFF)
    r, jacobian = view_residuals(target, source, T, 1e6)
    step = 1e-7  # almost no point changes its pixel
    for axis in range(6):
        ahead, behind = (
            view_residuals(target, source, apply_motion(T, s * step * np.eye(6)[axis]), 1e6)[0] for s in (1, -1)
        )
        assert len(ahead) == len(behind) == len(r)
        close = np.abs((ahead - behind) / (2 * step) - jacobian[:, axis]) < 1e-3 * np.abs(jacobian[:, axis]).max()
        assert close.mean() > 0.99


def test_a_corner_gives_the_motion(pair):
    target, source, true = pair
    found, information = align_views(target, source, apply_motion(true, OFF))
    off = inverse(true) @ found
    assert np.linalg.norm(off[:3, 3]) < 1e-3
    assert rotation_angle(off) < 1e-3
    assert np.linalg.eigvalsh(information).min() > 0


def test_the_target_may_stand_anywhere(pair):
    target, source, true = pair
    anywhere = apply_motion(np.eye(4), np.array([3.0, -2.0, 1.0, 0.4, 2.0, -0.3]))
    found, _ = minimise(anywhere @ apply_motion(true, OFF), [view_term(target, anywhere, source, 15.0)], 20)
    assert np.abs(motion_between(anywhere @ true, found)).max() < 1e-3


def test_along_a_plane_nothing_moves():
    start = apply_motion(np.eye(4), np.array([0.03, -0.02, 0.04, 0.0, 0.0, 0.02]))
    found, information = align_views(plane(), plane(), start)
    motion = motion_between(np.eye(4), found)
    assert abs(motion[2]) < 1e-4
    np.testing.assert_allclose(motion[[0, 1, 5]], [0.03, -0.02, 0.02], atol=1e-4)
    np.testing.assert_allclose(information[[0, 1, 5]][:, [0, 1, 5]], 0, atol=1e-6)


def test_information_is_less_where_the_surfaces_fit_worse():
    """2 cm of noise where 1 cm was promised: residuals of sqrt(2) sigma, and 0.73 is their mean Cauchy weight."""
    target, source = plane(), plane()
    _, sure = align_views(target, source, np.eye(4))
    z = 1.5 + np.random.default_rng(0).normal(0, 0.02, (120, 160, 1))
    noisy = SurfaceView(CAMERA, source.points * z / 1.5, source.normals, source.sigma)
    _, unsure = align_views(target, noisy, np.eye(4))
    assert unsure[2, 2] / sure[2, 2] == pytest.approx(0.73 / 2, rel=0.1)


def test_views_that_do_not_fit_are_refused(box_room, pair):
    target, source, true = pair
    assert align_views(target, view(box_room, box_room.pose(CORNER + np.pi)), inverse(np.eye(4))) is None
    assert align_views(target, source, apply_motion(true, np.array([0.0, 0.0, 0.6, 0.0, 0.0, 0.0]))) is None
    empty = SurfaceView(source.camera, source.points, source.normals, np.full(source.sigma.shape, np.inf))
    assert align_views(target, empty, true) is None
    assert align_views(empty, source, true) is None


def test_surfaces_that_face_away_are_no_pairs(pair):
    target, source, true = pair
    turned = SurfaceView(source.camera, source.points, -source.normals, source.sigma)
    assert len(view_residuals(target, turned, true)[0]) == 0
