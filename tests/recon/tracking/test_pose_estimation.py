"""The pose of one frame from points that are known, from beliefs, and from too little."""

import numpy as np
import pytest
from uncle.recon.core.se3 import apply_motion, inverse, motion_between, rotation_angle
from uncle.recon.tracking.pose_estimation import (
    MIN_INLIERS,
    Linearised,
    feature_term,
    minimise,
    prior_term,
    ransac_pose,
)

OFF = np.array([0.1, -0.05, 0.08, 0.03, 0.05, -0.04])


def assert_pose(found, true, shift_m: float = 1e-5, turn_rad: float = 1e-5) -> None:
    off = inverse(true) @ found
    assert np.linalg.norm(off[:3, 3]) < shift_m
    assert rotation_angle(off) < turn_rad


def test_features_bring_the_camera_back(make_scene):
    scene = make_scene(1)
    term = feature_term(scene.camera, scene.points, scene.observations)
    found, information = minimise(apply_motion(scene.poses[0], OFF), [term], 20)
    assert_pose(found, scene.poses[0])
    np.testing.assert_allclose(information, term(found).information)
    assert np.linalg.eigvalsh(information).min() > 1


def test_features_with_wrong_readings_bring_the_camera_back(make_scene):
    scene = make_scene(1, 200, lying=0.4)
    term = feature_term(scene.camera, scene.points, scene.observations)
    found, _ = minimise(apply_motion(scene.poses[0], OFF), [term], 30)
    assert_pose(found, scene.poses[0], 0.002, 0.001)


def test_a_prior_alone_is_the_answer():
    expected = apply_motion(np.eye(4), 3 * OFF)
    found, information = minimise(np.eye(4), [prior_term(expected, 5 * np.eye(6))], 20)
    assert_pose(found, expected, 1e-4, 1e-4)
    np.testing.assert_allclose(information, 5 * np.eye(6))


def test_two_beliefs_meet_by_their_information():
    there = apply_motion(np.eye(4), np.array([0.4, 0.0, 0.0, 0.0, 0.0, 0.0]))
    found, _ = minimise(np.eye(4), [prior_term(np.eye(4), np.eye(6)), prior_term(there, 3 * np.eye(6))], 20)
    np.testing.assert_allclose(motion_between(np.eye(4), found), [0.3, 0, 0, 0, 0, 0], atol=1e-5)


def test_a_direction_that_no_term_sees_is_not_moved():
    """Only x is known to be off; z is known to be right, and all else is unknown."""
    information = np.diag([1e4, 0.0, 1e4, 0.0, 0.0, 0.0])
    start = apply_motion(np.eye(4), OFF * [1, 1, 0, 1, 1, 1])
    target = start.copy()
    target[:3, 3] -= 0.3 * start[:3, 0]
    found, _ = minimise(start, [prior_term(target, information)], 20)
    np.testing.assert_allclose(motion_between(start, found), [-0.3, 0, 0, 0, 0, 0], atol=1e-6)


def test_points_on_a_ray_do_not_turn_the_camera_about_it(make_scene):
    """Turning about the axis of view moves nothing that lies on it."""
    scene = make_scene(1, 20)
    points = np.linspace([0, 0, 1.0], [0, 0, 3.0], 20)
    uv = np.tile([scene.camera.cx, scene.camera.cy], (20, 1))
    seen = type(scene.observations)(
        np.zeros(20, int), np.arange(20), uv, np.ones(20), points[:, 2:], np.full((20, 1), 0.01), np.ones(20)
    )
    start = apply_motion(np.eye(4), np.array([0.02, 0.01, 0.03, 0.0, 0.0, 0.5]))
    found, _ = minimise(start, [feature_term(scene.camera, points, seen)], 20)
    assert motion_between(np.eye(4), found)[5] == pytest.approx(0.5, abs=1e-3)
    assert abs(found[2, 3]) < 1e-3


def test_a_cost_that_is_not_a_number_is_never_taken():
    def term(pose):
        cost = np.nan if pose[0, 3] > 0.1 else -pose[0, 3]
        return Linearised(cost, np.diag([1.0, 0, 0, 0, 0, 0]), np.array([-1.0, 0, 0, 0, 0, 0]))

    found, _ = minimise(np.eye(4), [term], 20)
    assert 0 < found[0, 3] <= 0.1


@pytest.mark.parametrize("seed", range(3))
def test_ransac_with_half_of_the_matches_wrong(make_scene, seed):
    scene, rng = make_scene(1, 100), np.random.default_rng(seed)
    uv, wrong = scene.observations.uv.copy(), rng.permutation(100)[:50]
    uv[wrong] = rng.uniform([0, 0], [320, 240], (50, 2))
    pose, agreeing = ransac_pose(scene.camera, scene.points, uv, seed)
    assert_pose(pose, scene.poses[0], 0.02, 0.01)
    assert set(agreeing) >= set(range(100)) - set(wrong)
    assert len(agreeing) < 55
    again = ransac_pose(scene.camera, scene.points, uv, seed)
    np.testing.assert_array_equal(again[0], pose)


def test_ransac_refuses_too_few_and_nonsense(make_scene):
    scene, rng = make_scene(1, 40), np.random.default_rng(0)
    few = MIN_INLIERS - 1
    assert ransac_pose(scene.camera, scene.points[:few], scene.observations.uv[:few], 0) is None
    assert ransac_pose(scene.camera, scene.points, rng.uniform([0, 0], [320, 240], (40, 2)), 0) is None


@pytest.mark.parametrize("points", [np.zeros((30, 3)), np.ones((30, 3)), np.full((30, 3), np.nan)])
def test_ransac_survives_degenerate_points(make_scene, points):
    """One point thirty times, or none: no pose, or at least a finite one, and no error."""
    scene, uv = make_scene(1, 30), np.tile([100.0, 80.0], (30, 1))
    for pixels in (uv, uv + np.arange(30)[:, None]):
        found = ransac_pose(scene.camera, points, pixels, 0)
        assert found is None or np.isfinite(found[0]).all()
