"""How well the colours of several views agree on a depth: the innermost loops of matching, compiled.

Matching by zero-mean normalised cross-correlation (ZNCC) of small windows, along the rays of a reference image around a
depth that is roughly known. Shapes: images (H, W) float32, grey levels 0..255.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit

from ..core.camera import Camera

WINDOW = 9  # pixels
NOISE = 1.0  # grey levels squared: what two images differ by where there is nothing to see
_MIN_INVERSE = 0.03  # 1 / metres: nothing is looked for farther away


@dataclass(frozen=True)
class GreyView:
    """An image and where it was taken: grey (H, W), T_world_camera (4, 4)."""

    index: int
    grey: np.ndarray
    T_world_camera: np.ndarray


def zncc_volume(
    camera: Camera, reference: GreyView, sources: list[GreyView], inverse_depth: np.ndarray, offsets: np.ndarray
) -> np.ndarray:
    """(n, H, W) agreement -1..1 at 1 / z = inverse_depth (H, W) + offsets (n,), both 1 / metres.

    It is the mean of the better half of the sources that look there, since some may see another surface in between;
    -1 where none looks.
    """
    ray_rows, motions = camera.rays().numpy(), [_motion(reference, source) for source in sources]
    rotated = [np.ascontiguousarray(np.moveaxis(ray_rows @ m[:, :3].T, -1, 0)) for m in motions]
    mean = _box(reference.grey)
    variance = _box(reference.grey**2) - mean**2
    pinhole = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    warped, inside = np.empty_like(reference.grey), np.empty(reference.grey.shape, np.bool_)
    scores = np.empty((len(sources), *reference.grey.shape), np.float32)
    volume = np.empty((len(offsets), *reference.grey.shape), np.float32)
    for layer, offset in zip(volume, offsets, strict=True):
        inverse = np.maximum(inverse_depth + np.float32(offset), np.float32(_MIN_INVERSE))
        for source, ray, motion, score in zip(sources, rotated, motions, scores, strict=True):
            _warp(source.grey, ray, motion[:, 3].copy(), inverse, pinhole, WINDOW // 2, warped, inside)
            sums = (_box(warped), _box(warped * warped), _box(warped * reference.grey))
            _correlate(mean, variance, *sums, inside, np.float32(NOISE), score)
        _better_half(scores, layer)
    return volume


def texture(grey: np.ndarray) -> np.ndarray:
    """(H, W) variance of the grey levels in the window around each pixel."""
    return np.maximum(_box(grey**2) - _box(grey) ** 2, 0)


def _motion(reference: GreyView, source: GreyView) -> np.ndarray:
    """(3, 4) float32 from the axes of the reference camera to those of the source."""
    return (np.linalg.inv(source.T_world_camera) @ reference.T_world_camera)[:3].astype(np.float32)


def _box(image: np.ndarray) -> np.ndarray:
    return cv2.blur(image, (WINDOW, WINDOW), borderType=cv2.BORDER_REFLECT)


@njit(nogil=True, cache=True, fastmath=True)
def _warp(source, rays, shift, inverse, pinhole, margin, warped, inside):
    """Colours of `source` where it sees the points at 1 / depth `inverse`; rays (3, H, W) and shift (3,) in its axes.

    `inside`: whether the window around the point is, too. Projection only needs rays + shift / depth.
    """
    height, width = inverse.shape
    fx, fy, cx, cy = pinhole[0], pinhole[1], pinhole[2], pinhole[3]
    for row in range(height):
        for column in range(width):
            warped[row, column], inside[row, column] = 0, False
            near = inverse[row, column]
            z = rays[2, row, column] + shift[2] * near
            if z <= 1e-3:
                continue
            u = fx * (rays[0, row, column] + shift[0] * near) / z + cx
            v = fy * (rays[1, row, column] + shift[1] * near) / z + cy
            if not (u >= 0 and v >= 0 and u < width - 1 and v < height - 1):
                continue
            inside[row, column] = u >= margin and v >= margin and u < width - margin and v < height - margin
            x, y = int(u), int(v)
            a, b = u - x, v - y
            above = source[y, x] * (1 - a) + source[y, x + 1] * a
            below = source[y + 1, x] * (1 - a) + source[y + 1, x + 1] * a
            warped[row, column] = above * (1 - b) + below * b


@njit(nogil=True, cache=True)
def _correlate(mean, variance, mean_there, square_there, product, inside, noise, score):
    """ZNCC (H, W) from the box means of both images, their squares and their product; NaN where not `inside`."""
    for row in range(mean.shape[0]):
        for column in range(mean.shape[1]):
            if not inside[row, column]:
                score[row, column] = np.nan
                continue
            there = mean_there[row, column]
            spread = max(square_there[row, column] - there * there, np.float32(0))
            common = product[row, column] - mean[row, column] * there
            own = max(variance[row, column], np.float32(0))
            score[row, column] = common / np.sqrt((own + noise) * (spread + noise))


@njit(nogil=True, cache=True)
def _better_half(scores, result):
    """(K, H, W) with NaN = does not look there -> (H, W)."""
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
