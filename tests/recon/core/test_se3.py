"""Small rigid motions against SciPy's matrix exponential and each other."""

import numpy as np
import pytest
from scipy.linalg import expm
from uncle.recon.core.se3 import angle, cross_matrix, inverse, motion_between, moved, transform

RNG = np.random.default_rng(0)
MOTIONS = RNG.uniform(-1, 1, (2, 5, 6))
POSES = moved(np.eye(4), RNG.uniform(-1, 1, (2, 5, 6)))


def test_moved_turns_by_the_exponential_in_camera_axes():
    motion = np.array([0.1, -0.2, 0.3, 0.4, -0.5, 0.6])
    step = np.eye(4)
    step[:3, :3], step[:3, 3] = expm(cross_matrix(motion[3:])), motion[:3]
    np.testing.assert_allclose(moved(POSES[0, 0], motion), POSES[0, 0] @ step, atol=1e-12)


def test_a_known_motion():
    forward = moved(np.eye(4), np.array([0.0, 0.0, 2.0, 0.0, np.pi / 2, 0.0]))
    np.testing.assert_allclose(transform(forward, np.array([0.0, 0.0, 1.0])), [1.0, 0.0, 2.0], atol=1e-12)


def test_motion_between_undoes_moved():
    np.testing.assert_allclose(motion_between(POSES, moved(POSES, MOTIONS)), MOTIONS, atol=1e-12)


def test_inverse_is_that_of_the_matrix():
    np.testing.assert_allclose(inverse(POSES), np.linalg.inv(POSES), atol=1e-12)


def test_transform_is_the_product_with_homogeneous_points():
    points = RNG.normal(size=(2, 5, 3))
    expected = (POSES @ np.concatenate([points, np.ones((2, 5, 1))], -1)[..., None])[..., :3, 0]
    np.testing.assert_allclose(transform(POSES, points), expected, atol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 1e-3, 1.0, np.pi])
def test_angle(turn):
    axis = np.array([0.6, 0.0, -0.8])
    pose = moved(np.eye(4), np.concatenate([np.ones(3), turn * axis]))
    assert angle(pose) == pytest.approx(turn, abs=1e-7)


def test_cross_matrix():
    a, b = RNG.normal(size=(2, 4, 3))
    np.testing.assert_allclose((cross_matrix(a) @ b[..., None])[..., 0], np.cross(a, b), atol=1e-12)
