"""The compiled cost volume against a slow, explicit ZNCC, and what it must not depend on."""

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation
from uncle.recon.core.camera import Camera
from uncle.recon.mvs.cost_volume import CostVolumeParameters, GreyView, texture, zncc_volume

CAMERA = Camera(48, 36, 40.0, 42.0, 23.0, 18.0)
WINDOW, NOISE = CostVolumeParameters.window_px, CostVolumeParameters.noise_variance
HALF = WINDOW // 2


def windows(image: np.ndarray) -> np.ndarray:
    """(H, W, WINDOW^2) pixels around each pixel."""
    padded = np.pad(image.astype(np.float64), HALF, mode="symmetric")
    return sliding_window_view(padded, (WINDOW, WINDOW)).reshape(*image.shape, -1)


def slow_score(reference: GreyView, sources: list[GreyView], inverse: np.ndarray) -> np.ndarray:
    """(H, W) `zncc_volume` of one layer, in double precision, pixel by pixel."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)], -1)
    world = rays / inverse[..., None] @ reference.T_world_camera[:3, :3].T + reference.T_world_camera[:3, 3]
    scores = []
    for source in sources:
        there = (world - source.T_world_camera[:3, 3]) @ source.T_world_camera[:3, :3]
        x = CAMERA.fx * there[..., 0] / there[..., 2] + CAMERA.cx
        y = CAMERA.fy * there[..., 1] / there[..., 2] + CAMERA.cy
        within = (there[..., 2] > 0) & (x >= 0) & (y >= 0) & (x < CAMERA.width - 1) & (y < CAMERA.height - 1)
        warped = np.where(within, map_coordinates(source.grey.astype(np.float64), [y, x], order=1), 0)
        ours, theirs = windows(reference.grey), windows(warped)
        common = ((ours - ours.mean(-1, keepdims=True)) * (theirs - theirs.mean(-1, keepdims=True))).mean(-1)
        score = common / np.sqrt((ours.var(-1) + NOISE) * (theirs.var(-1) + NOISE))
        margin = (x >= HALF) & (y >= HALF) & (x < CAMERA.width - HALF) & (y < CAMERA.height - HALF)
        scores.append(np.where(within & margin, score, np.nan))
    result = np.full(inverse.shape, -1.0)
    for row, column in np.ndindex(inverse.shape):
        seen = [s[row, column] for s in scores if not np.isnan(s[row, column])]
        if seen:
            result[row, column] = np.mean(sorted(seen)[len(seen) // 2 :])  # of three the better two
    return result


def view(index: int, x=0.0, y=0.0, z=0.0, turn: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> GreyView:
    grey = gaussian_filter(np.random.default_rng(index).normal(0, 400, (CAMERA.height, CAMERA.width)), 1.5) + 120
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), (x, y, z)
    return GreyView(index, grey.astype(np.float32), pose)


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_score_is_the_mean_zncc_of_the_better_half_of_the_sources_that_see_the_point(count):
    reference = view(0, 1.0, -0.5, 0.2, turn=(0.1, -0.3, 0.2))
    sources = [
        view(1, 1.2, -0.5, 0.2, turn=(0.1, -0.3, 0.2)),
        view(2, 0.7, -0.6, 0.3, turn=(0.15, -0.2, 0.2)),
        view(3, 1.0, -0.2, 0.0, turn=(0.0, -0.35, 0.5)),
        view(4, 1.1, -0.3, 0.1, turn=(0.2, -0.4, 0.1)),
    ][:count]
    inverse = (0.5 + 0.1 * np.random.default_rng(9).random((CAMERA.height, CAMERA.width))).astype(np.float32)
    offsets = np.array([-0.05, 0.0, 0.08])
    volume = zncc_volume(CAMERA, reference, sources, inverse, offsets)
    assert volume.shape == (3, CAMERA.height, CAMERA.width)
    for layer, offset in zip(volume, offsets, strict=True):
        expected = slow_score(reference, sources, inverse + offset)
        assert (expected > -1).mean() > 0.3
        near_rim = (layer == -1) != (expected == -1)  # rounding decides which side of the rim a point is on
        assert near_rim.mean() < 0.01
        assert np.abs(layer - expected)[~near_rim].max() < 0.02
        assert np.abs(layer - expected)[~near_rim].mean() < 1e-4


def test_no_source_sees_the_point():
    away = view(1, turn=(0.0, np.pi, 0.0))
    flat = np.full((CAMERA.height, CAMERA.width), 0.5, np.float32)
    assert (zncc_volume(CAMERA, view(0), [away], flat, np.zeros(1)) == -1).all()


def test_exposure_does_not_matter():
    here, flat = view(0), np.full((CAMERA.height, CAMERA.width), 0.5, np.float32)
    same = GreyView(1, here.grey, here.T_world_camera)
    brighter = GreyView(1, 1.4 * here.grey + 30, here.T_world_camera)
    negative = GreyView(1, 255 - here.grey, here.T_world_camera)
    scores = [zncc_volume(CAMERA, here, [other], flat, np.zeros(1))[0] for other in (same, brighter, negative)]
    inner = np.s_[HALF + 1 : -HALF - 1, HALF + 1 : -HALF - 1]
    assert scores[0][inner].min() > 0.98
    assert scores[1][inner].min() > 0.98
    assert scores[2][inner].max() < -0.98


@pytest.mark.parametrize("level", [0.0, 137.0, 255.0])
def test_flat_images_have_a_score_of_zero(level):
    image = np.full((CAMERA.height, CAMERA.width), level, np.float32)
    here, there = GreyView(0, image, view(0).T_world_camera), GreyView(1, image, view(1, 0.1).T_world_camera)
    volume = zncc_volume(CAMERA, here, [there], np.full_like(image, 0.5), np.zeros(1))
    assert (volume > -1).mean() > 0.3
    assert np.abs(volume[volume > -1]).max() < 1e-2


def test_texture_is_the_variance_in_the_window():
    grey = view(0).grey
    np.testing.assert_allclose(texture(grey), windows(grey).var(-1), rtol=1e-3, atol=0.05)
    assert texture(np.full((20, 20), 251, np.float32)).max() < 0.1


def test_a_larger_window_smooths_the_score():
    reference, source = view(0), view(1, 0.1)
    flat = np.full((CAMERA.height, CAMERA.width), 0.5, np.float32)
    spread = []
    for window_px in (5, 15):
        parameters = CostVolumeParameters(window_px=window_px)
        score = zncc_volume(CAMERA, reference, [source], flat, np.zeros(1), parameters)[0]
        spread.append(score[score > -1].std())
    assert spread[1] < spread[0]
