"""Features of images whose motion is known, and pairs of descriptors."""

import cv2
import numpy as np
import pytest
from uncle.recon.tracking.local_features import extract_features, match, match_near


@pytest.fixture(scope="module")
def texture() -> np.ndarray:
    """(280, 360, 3) uint8: blobs of several sizes."""
    rng = np.random.default_rng(0)
    layers = [cv2.GaussianBlur(rng.normal(size=(280, 360, 3)), (0, 0), sigma) * sigma for sigma in (1.5, 3.0, 6.0)]
    image = sum(layers)
    return np.clip(128 + 60 * image / image.std(), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("shift", [(0, 0), (12, 7), (-9, 15)])
def test_a_shifted_image_gives_matches_of_that_shift(texture, shift):
    dx, dy = shift
    first = extract_features(texture[20:260, 20:340])
    second = extract_features(texture[20 - dy : 260 - dy, 20 - dx : 340 - dx])
    pairs = match(first.descriptors @ second.descriptors.T)
    moves = second.uv[pairs[:, 1]] - first.uv[pairs[:, 0]]
    right = np.abs(moves - shift).max(1) < 0.5
    assert right.sum() > 150
    assert right.mean() > 0.95
    np.testing.assert_allclose(np.median(moves, 0), shift, atol=0.02)


def test_features_are_whole_and_distinct(texture):
    found = extract_features(texture, 200)
    assert 100 < len(found) < 240
    assert found.descriptors.shape == (len(found), 128)
    assert found.descriptors.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1, atol=1e-5)
    assert len(np.unique(found.uv, axis=0)) == len(found)
    assert found.sigma_px.shape == (len(found),)
    assert found.sigma_px.min() > 0.4


def test_a_pixel_centre_has_integer_coordinates():
    """A round blob about a known pixel is found there."""
    v, u = np.indices((120, 160))
    blob = 30 + 200 * np.exp(-((u - 83.0) ** 2 + (v - 41.0) ** 2) / (2 * 5.0**2))
    found = extract_features(np.repeat(blob.astype(np.uint8)[..., None], 3, 2))
    assert np.linalg.norm(found.uv - [83.0, 41.0], axis=1).min() < 0.1


@pytest.mark.parametrize("shape", [(240, 320), (1, 1), (3, 200), (8, 8)])
def test_blank_and_tiny_images_have_none(shape):
    found = extract_features(np.full((*shape, 3), 128, np.uint8))
    assert len(found) == 0
    assert found.uv.shape == (0, 2)
    assert found.descriptors.shape == (0, 128)
    assert match(found.descriptors @ np.ones((128, 5))).shape == (0, 2)


def test_pairs_choose_each_other_and_are_not_ambiguous():
    similarity = np.array([
        [0.9, 0.1, 0.2, 0.0],  # 0 - 0
        [0.8, 0.1, 0.0, 0.0],  # likes 0, which prefers row 0
        [0.0, 0.7, 0.71, 0.0],  # cannot decide
        [0.0, 0.0, 0.1, 0.6],  # 3 - 3
    ])  # fmt: skip
    assert match(similarity).tolist() == [[0, 0], [3, 3]]
    assert match(similarity[:1]).shape == match(similarity[:, :1]).shape == (0, 2)


def test_near_pairs_are_near_and_alike():
    similarity = np.array([[0.95, 0.9, 0.0], [0.9, 0.1, 0.8], [0.0, 0.2, 0.7]])
    near = np.argwhere([[False, True, True], [True, True, True], [True, True, True]])
    for threshold in (0.75, 0.6):  # row 2 likes a column that prefers row 1
        assert sorted(match_near(similarity, near, threshold).tolist()) == [[0, 1], [1, 0]]
    assert match_near(similarity, near, 0.9).shape == (0, 2)
    assert match_near(similarity, near[:0]).shape == (0, 2)
    assert match_near(np.zeros((0, 3)), near[:0]).shape == (0, 2)


def test_features_of_a_large_image_lie_where_they_lie_in_the_small_one(texture):
    small = texture[:240, :320]
    large = small.repeat(3, axis=0).repeat(3, axis=1)
    found, expected = extract_features(large), extract_features(small)
    assert len(found) == len(expected) > 50
    np.testing.assert_allclose(found.uv, (expected.uv + 0.5) * 3 - 0.5)
    np.testing.assert_allclose(found.sigma_px, expected.sigma_px * 3)
