"""Cost volume of plane-sweep stereo: zero-mean normalised cross-correlation (ZNCC) of small windows, compiled loops.

Shapes: images (H, W) float32, grey levels 0..255.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..core.camera import Camera
from ..core.compiled import compiled


@dataclass(frozen=True)
class CostVolumeParameters:
    """window_px: side of the window; noise_variance: expected difference between two images of a uniform surface, grey
    levels squared, added to both variances; min_inverse_depth: 1 / metres, nothing is searched farther away."""

    window_px: int = 9
    noise_variance: float = 1.0
    min_inverse_depth: float = 0.03


@dataclass(frozen=True)
class GreyView:
    """Frame `index`: its grey image (H, W) and pose T_world_camera (4, 4)."""

    index: int
    grey: np.ndarray
    T_world_camera: np.ndarray


def zncc_volume(
    camera: Camera,
    reference: GreyView,
    sources: list[GreyView],
    inverse_depth: np.ndarray,
    offsets: np.ndarray,
    parameters: CostVolumeParameters = CostVolumeParameters(),
) -> np.ndarray:
    """(n, H, W) ZNCC, -1..1, at 1 / z = inverse_depth (H, W) + offsets (n,), both 1 / metres.

    The score is the mean over the better half of the sources that see the point, as others may be occluded; -1 where no
    source sees it.
    """
    window = parameters.window_px
    directions, motions = camera.rays().numpy(), [_motion(reference, source) for source in sources]
    rotated = [np.ascontiguousarray(np.moveaxis(directions @ m[:, :3].T, -1, 0)) for m in motions]
    mean = _box(reference.grey, window)
    variance = _box(reference.grey**2, window) - mean**2
    pinhole = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    warped, inside = np.empty_like(reference.grey), np.empty(reference.grey.shape, np.bool_)
    scores = np.empty((len(sources), *reference.grey.shape), np.float32)
    volume = np.empty((len(offsets), *reference.grey.shape), np.float32)
    for layer, offset in zip(volume, offsets, strict=True):
        inverse = np.maximum(inverse_depth + np.float32(offset), np.float32(parameters.min_inverse_depth))
        for source, rays, motion, score in zip(sources, rotated, motions, scores, strict=True):
            _warp(source.grey, rays, motion[:, 3].copy(), inverse, pinhole, window // 2, warped, inside)
            means = (_box(warped, window), _box(warped * warped, window), _box(warped * reference.grey, window))
            _correlate(mean, variance, *means, inside, np.float32(parameters.noise_variance), score)
        _mean_of_better_half(scores, layer)
    return volume


def texture(grey: np.ndarray, window_px: int = CostVolumeParameters.window_px) -> np.ndarray:
    """(H, W) variance of the grey levels in the window around each pixel."""
    variance: np.ndarray = np.maximum(_box(grey**2, window_px) - _box(grey, window_px) ** 2, 0)
    return variance


def _motion(reference: GreyView, source: GreyView) -> np.ndarray:
    """(3, 4) float32 [R | t] from the axes of the reference camera to those of the source."""
    T_source_reference: np.ndarray = np.linalg.inv(source.T_world_camera) @ reference.T_world_camera
    return T_source_reference[:3].astype(np.float32)


def _box(image: np.ndarray, window_px: int) -> np.ndarray:
    """(H, W) mean of the window around each pixel."""
    mean: np.ndarray = cv2.blur(image, (window_px, window_px), borderType=cv2.BORDER_REFLECT)
    return mean


@compiled(fastmath=True)
def _warp(
    source: np.ndarray,
    rays: np.ndarray,
    shift: np.ndarray,
    inverse: np.ndarray,
    pinhole: np.ndarray,
    margin: int,
    warped: np.ndarray,
    inside: np.ndarray,
) -> None:
    """Grey levels `warped` (H, W) of `source` at the points of inverse depth `inverse` (H, W); rays (3, H, W) and shift
    (3,) in the axes of the source.

    `inside` (H, W): the window around the projected point is within the image, too. The projection of
    rays + shift * inverse equals that of the point, so no depth is divided by.
    """
    height, width = inverse.shape
    fx, fy, cx, cy = pinhole[0], pinhole[1], pinhole[2], pinhole[3]
    for row in range(height):
        for column in range(width):
            warped[row, column], inside[row, column] = 0, False
            inverse_z = inverse[row, column]
            z = rays[2, row, column] + shift[2] * inverse_z
            if z <= 1e-3:
                continue
            u = fx * (rays[0, row, column] + shift[0] * inverse_z) / z + cx
            v = fy * (rays[1, row, column] + shift[1] * inverse_z) / z + cy
            if not (u >= 0 and v >= 0 and u < width - 1 and v < height - 1):
                continue
            inside[row, column] = u >= margin and v >= margin and u < width - margin and v < height - margin
            x, y = int(u), int(v)
            a, b = u - x, v - y
            upper = source[y, x] * (1 - a) + source[y, x + 1] * a
            lower = source[y + 1, x] * (1 - a) + source[y + 1, x + 1] * a
            warped[row, column] = upper * (1 - b) + lower * b


@compiled()
def _correlate(
    mean: np.ndarray,
    variance: np.ndarray,
    source_mean: np.ndarray,
    source_square: np.ndarray,
    product: np.ndarray,
    inside: np.ndarray,
    noise: np.float32,
    score: np.ndarray,
) -> None:
    """ZNCC (H, W) into `score`, from window means of both images, their squares and product; NaN where not `inside`."""
    for row in range(mean.shape[0]):
        for column in range(mean.shape[1]):
            if not inside[row, column]:
                score[row, column] = np.nan
                continue
            mean_level = source_mean[row, column]
            source_variance = max(source_square[row, column] - mean_level * mean_level, np.float32(0))
            covariance = product[row, column] - mean[row, column] * mean_level
            reference_variance = max(variance[row, column], np.float32(0))
            score[row, column] = covariance / np.sqrt((reference_variance + noise) * (source_variance + noise))


@compiled()
def _mean_of_better_half(scores: np.ndarray, result: np.ndarray) -> None:
    """scores (K, H, W), NaN = not seen by that source -> `result` (H, W): mean of the higher half of the scores."""
    best = np.empty(len(scores), np.float32)
    for row in range(result.shape[0]):
        for column in range(result.shape[1]):
            count = 0
            for source in range(len(scores)):
                value = scores[source, row, column]
                if np.isnan(value):
                    continue
                place = count
                while place > 0 and best[place - 1] < value:
                    best[place] = best[place - 1]
                    place -= 1
                best[place] = value
                count += 1
            half = (count + 1) // 2
            result[row, column] = best[:half].mean() if count else np.float32(-1)
