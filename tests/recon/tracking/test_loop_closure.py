"""Pose graphs whose answer is known."""

import itertools

import numpy as np
from uncle.recon.core.se3 import apply_motion, inverse
from uncle.recon.tracking.loop_closure import corrected_poses


def circle(count: int) -> np.ndarray:
    """Poses once around, each looking along the circle of 2 m."""
    turn = np.array([0.0, 0.0, 0.0, 0.0, 2 * np.pi / count, 0.0])
    steps = [np.eye(4)]
    for _ in range(count - 1):
        steps.append(apply_motion(steps[-1], turn + np.eye(6)[2] * (4 * np.pi / count)))
    return np.stack(steps)


def drifted(true: np.ndarray, each: np.ndarray) -> np.ndarray:
    poses = [true[0]]
    for before, after in itertools.pairwise(true):
        poses.append(poses[-1] @ apply_motion(inverse(before) @ after, each))
    return np.stack(poses)


def errors(poses: np.ndarray, true: np.ndarray) -> np.ndarray:
    return np.linalg.norm(poses[:, :3, 3] - true[:, :3, 3], axis=1)


def test_a_loop_spreads_its_error_over_a_line():
    """Nine steps of 1 m that were measured as 1.01 m: the loop and the steps are all as sure."""
    line = np.tile(np.eye(4), (10, 1, 1))
    line[:, 0, 3] = 1.01 * np.arange(10)
    whole = np.eye(4)
    whole[0, 3] = 9.0
    found = corrected_poses(line, [(0, 9, whole)])
    steps = np.diff(found[:, 0, 3])
    np.testing.assert_allclose(steps, 1.01 - 0.09 / 10, atol=1e-3)  # ten edges share 0.09 m
    np.testing.assert_allclose(found[0], np.eye(4), atol=1e-9)


def test_a_loop_straightens_a_circle():
    true = circle(16)
    poses = drifted(true, np.array([0.004, 0.008, 0.005, 0.001, 0.002, -0.001]))
    found = corrected_poses(poses, [(0, 15, inverse(true[0]) @ true[15])])
    assert errors(poses, true)[-1] > 0.06
    assert errors(found, true)[-1] < 0.1 * errors(poses, true)[-1]
    assert errors(found, true).max() < 0.6 * errors(poses, true).max()
    np.testing.assert_allclose(found[0], poses[0], atol=1e-9)


def test_a_wrong_loop_is_switched_off():
    true = circle(16)
    wrong = inverse(true[2]) @ true[9] @ apply_motion(np.eye(4), np.array([1.5, 0.4, -1.0, 0.0, 1.0, 0.0]))
    found = corrected_poses(true, [(0, 15, inverse(true[0]) @ true[15]), (2, 9, wrong)])
    assert errors(found, true).max() < 0.02


def test_without_loops_and_without_contradiction_nothing_moves():
    true = circle(8)
    np.testing.assert_allclose(corrected_poses(true, []), true, atol=1e-6)
    np.testing.assert_allclose(corrected_poses(true, [(0, 7, inverse(true[0]) @ true[7])]), true, atol=1e-6)
