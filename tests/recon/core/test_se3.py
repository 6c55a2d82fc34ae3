"""Small rigid motions against SciPy's matrix exponential and each other."""

import numpy as np
import pytest
from scipy.linalg import expm
from uncle.recon.core.se3 import (
    adjoint,
    apply_motion,
    cross_matrix,
    inverse,
    motion_between,
    predict_pose,
    rotation_angle,
    transform,
)

RNG = np.random.default_rng(0)
MOTIONS = RNG.uniform(-1, 1, (2, 5, 6))
POSES = apply_motion(np.eye(4), RNG.uniform(-1, 1, (2, 5, 6)))


def test_apply_motion_rotates_by_the_exponential_in_camera_axes():
    motion = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = expm(cross_matrix(motion[3:])), motion[:3]
    np.testing.assert_allclose(apply_motion(POSES[0, 0], motion), POSES[0, 0] @ step, atol=1e-12)


def test_a_known_motion():
    forward = apply_motion(np.eye(4), np.array([0.0, 0.0, 2.0, 0.0, np.pi / 2, 0.0]))
    np.testing.assert_allclose(transform(forward, np.array([0.0, 0.0, 1.0])), [1.0, 0.0, 2.0], atol=1e-12)


def test_motion_between_undoes_apply_motion():
    np.testing.assert_allclose(motion_between(POSES, apply_motion(POSES, MOTIONS)), MOTIONS, atol=1e-12)


def test_inverse_is_that_of_the_matrix():
    np.testing.assert_allclose(inverse(POSES), np.linalg.inv(POSES), atol=1e-12)


def test_transform_is_the_product_with_homogeneous_points():
    points = RNG.normal(size=(2, 5, 3))
    expected = (POSES @ np.concatenate([points, np.ones((2, 5, 1))], -1)[..., None])[..., :3, 0]
    np.testing.assert_allclose(transform(POSES, points), expected, atol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 1e-3, 1.0, np.pi])
def test_rotation_angle(turn):
    axis = np.array([0.6, 0.0, -0.8])
    pose = apply_motion(np.eye(4), np.concatenate([np.ones(3), turn * axis]))
    assert rotation_angle(pose) == pytest.approx(turn, abs=1e-7)


def test_cross_matrix():
    a, b = RNG.normal(size=(2, 4, 3))
    np.testing.assert_allclose((cross_matrix(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-12)


def test_rotation_angle_is_exact_for_small_angles_and_takes_rotations():
    pose = apply_motion(np.eye(4), np.array([0.0, 0.0, 0.0, 1e-9, 0.0, 0.0]))
    assert rotation_angle(pose) == pytest.approx(1e-9, rel=1e-6)
    np.testing.assert_array_equal(rotation_angle(POSES[..., :3, :3]), rotation_angle(POSES))


def test_adjoint_carries_a_small_motion_across_a_transform():
    T, x = POSES[0, 0], 1e-5 * RNG.uniform(-1, 1, 6)
    across = motion_between(T, apply_motion(np.eye(4), adjoint(T) @ x) @ T)
    np.testing.assert_allclose(across, x, atol=1e-9)
    np.testing.assert_allclose(adjoint(T) @ adjoint(inverse(T)), np.eye(6), atol=1e-12)


def test_a_camera_of_constant_velocity_repeats_its_last_motion():
    first, motion = POSES[0, 0], MOTIONS[0, 0]
    second = apply_motion(first, motion)
    np.testing.assert_allclose(predict_pose([POSES[1, 1], first, second]), apply_motion(second, motion), atol=1e-12)
    assert predict_pose([first]) is first
