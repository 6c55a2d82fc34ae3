"""Places seen before, among synthetic descriptors."""

import numpy as np
import pytest
from uncle.recon.core.camera import Camera
from uncle.recon.core.se3 import apply_motion, inverse, rotation_angle, transform
from uncle.recon.tracking.landmarks import NONE, FrameFeatures, Landmarks
from uncle.recon.tracking.place_recognition import recognise

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
