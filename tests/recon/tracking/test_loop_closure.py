"""Places seen before among synthetic descriptors, and pose graphs whose answer is known."""

import itertools

import numpy as np
import pytest
from uncle.recon.core.camera import Camera
from uncle.recon.core.se3 import apply_motion, inverse, rotation_angle, transform
from uncle.recon.tracking.landmarks import NONE, FrameFeatures, Landmarks
from uncle.recon.tracking.loop_closure import corrected_poses, recognise

CAMERA = Camera(320, 240, 200.0, 210.0, 160.0, 118.0)
KEYFRAMES, EACH = 5, 60


def descriptors(rng: np.random.Generator, count: int) -> np.ndarray:
    vectors = np.abs(rng.normal(size=(count, 128)))
    return (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)


@pytest.fixture(scope="module")
def world() -> tuple[Landmarks, dict[int, np.ndarray]]:
    """Landmarks in front of the origin, shared out among keyframes 10, 11, ..."""
    rng, landmarks = np.random.default_rng(0), Landmarks()
    points = rng.uniform([-0.8, -0.6, 1.5], [0.8, 0.6, 3.0], (KEYFRAMES * EACH, 3))
    numbers = landmarks.add(points, descriptors(rng, len(points)))
    return landmarks, {10 + k: numbers[k * EACH : (k + 1) * EACH] for k in range(KEYFRAMES)}


def look(landmarks: Landmarks, numbers: np.ndarray, pose: np.ndarray, independent: int = 40):
    """A view of the landmarks among features of nothing, with its descriptors; in mixed order."""
    rng = np.random.default_rng(1)
    local = transform(inverse(pose), landmarks.points[numbers])
    uv = local[:, :2] / local[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    uv = np.concatenate([uv, rng.uniform([0, 0], [320, 240], (independent, 2))])
    z = np.concatenate([local[:, 2:], np.zeros((independent, 1))])
    found = landmarks.descriptors[numbers] + rng.normal(0, 0.01, (len(numbers), 128))
    found = np.concatenate([found, descriptors(rng, independent)])
    found = (found / np.linalg.norm(found, axis=1, keepdims=True)).astype(np.float32)
    order, count = rng.permutation(len(uv)), len(uv)
    view = FrameFeatures(
        99, np.eye(4), uv[order], np.ones(count), z[order], np.full((count, 1), 0.02), np.zeros((count, 1)),
        np.zeros((count, 1, 0), np.float32), np.full(count, NONE),
    )  # fmt: skip
    return view, found[order], np.concatenate([numbers, np.full(independent, NONE)])[order]


@pytest.mark.parametrize("keyframe", [10, 13, 14])
def test_the_right_keyframe_is_found(world, keyframe):
    landmarks, candidates = world
    true = apply_motion(np.eye(4), np.array([0.2, -0.1, 0.1, 0.05, -0.1, 0.2]))
    view, found, numbers = look(landmarks, candidates[keyframe], true)
    place = recognise(CAMERA, view, found, candidates, landmarks, 0)
    assert place.keyframe == keyframe
    off = inverse(true) @ place.pose
    assert np.linalg.norm(off[:3, 3]) < 1e-3
    assert rotation_angle(off) < 1e-3
    assert len(place.rows) > 0.9 * EACH
    assert (numbers[place.rows] == place.numbers).all()


def test_an_unrelated_view_is_not_recognised(world):
    landmarks, candidates = world
    rng, other = np.random.default_rng(5), Landmarks()
    numbers = other.add(landmarks.points[:EACH], descriptors(rng, EACH))
    view, found, _ = look(other, numbers, np.eye(4))
    assert recognise(CAMERA, view, found, candidates, landmarks, 0) is None
    assert recognise(CAMERA, view, found, {}, landmarks, 0) is None


def test_alike_features_in_another_order_are_not_recognised(world):
    """The same look of things, but nothing is where it was."""
    landmarks, candidates = world
    view, found, _ = look(landmarks, candidates[12], np.eye(4))
    view.uv = np.random.default_rng(2).permutation(view.uv)
    assert recognise(CAMERA, view, found, candidates, landmarks, 0) is None


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
