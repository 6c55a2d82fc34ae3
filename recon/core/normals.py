"""Properties of the pixels of one depth image: edge-preserving smoothing, normals, incidence, gradients.

UncLe-SLAM derives normals by central differences from a bilaterally filtered depth image. These functions work on
inverse depth instead, for two reasons: the depth noise of stereo, structured light and similar sensors grows with the
square of the depth, so one range limit in 1/m holds at every distance; and the inverse depth of a plane is an affine
function of the pixel, so its differences are exact however steep the plane is.

Images are (H, W) float32; depth is in metres, 0 where there is no measurement. The normals of the published code are in
`methods/nice/published_normals.py`.
"""

from __future__ import annotations

import functools

import cv2
import numpy as np

from .camera import Camera

RANGE_SIGMA = 0.01  # 1/m: 1 cm at 1 m, 4 cm at 2 m, 9 cm at 3 m
# Two passes, over 3 x 3 neighbours and over 5 x 5 neighbours two pixels apart: they reach 5 pixels, smooth normals more
# than all pairs of a 9 x 9 window do, and take less than half its time.
PASSES = ((1, 1), (2, 2))  # taps to each side, pixels between taps
SPATIAL_SIGMA = 3.0  # pixels
MAX_TANGENT = 15.0  # tan(86 degrees): a steeper step from one pixel to the next is a depth edge, not a surface
_HOLE = np.float32(1e4)  # inverse depth of a hole: no second difference with it is within the range


def smooth_depth(depth: np.ndarray, range_sigma: float = RANGE_SIGMA) -> np.ndarray:
    """Bilateral filter: (H, W) float32 metres -> (H, W) float32 metres, 0 exactly where `depth` is 0.

    Neighbours enter as opposite pairs, weighted by how far their mean is from the centre (`range_sigma`, in 1/m of
    inverse depth). A plane is thus kept as it is, at image borders and beside holes too, where an ordinary filter
    bends it; and pairs with a hole or a pixel from behind an edge have weight 0.
    """
    inverse = _inverse(depth, hole=_HOLE)
    for taps in _WINDOWS:
        inverse = _smooth_inverse(inverse, taps, 3.0 * range_sigma)
    return np.where(depth > 0, np.float32(1.0) / inverse, np.float32(0.0))


def normals(depth: np.ndarray, camera: Camera, range_sigma: float = RANGE_SIGMA) -> np.ndarray:
    """(H, W) float32 metres -> (H, W, 3) float32 unit normals in camera axes, towards the camera; 0 where unknown.

    Give it smoothed depth. Differences are central where both neighbours lie on the surface of the pixel, one-sided
    where one does, and none is taken across a depth edge or from a hole.
    """
    inverse = _inverse(depth, hole=np.nan)
    du = _difference(inverse, 1, MAX_TANGENT / camera.fx, 3.0 * range_sigma)
    dv = _difference(inverse, 0, MAX_TANGENT / camera.fy, 3.0 * range_sigma)
    u = np.arange(camera.width, dtype=np.float32) - np.float32(camera.cx)
    v = np.arange(camera.height, dtype=np.float32)[:, None] - np.float32(camera.cy)
    # On the plane n . X = d the inverse depth is n . ray / d, which gives n / d from its value and its differences.
    result = np.empty((*depth.shape, 3), np.float32)
    z = inverse - u * du - v * dv
    x, y = du * np.float32(camera.fx), dv * np.float32(camera.fy)
    scale = np.float32(-1.0) / np.sqrt(x * x + y * y + z * z)  # n / d points away from the camera
    for channel, value in enumerate((x, y, z)):
        np.multiply(value, scale, out=result[..., channel])
    result[~np.isfinite(scale)] = 0.0
    return result


def incidence(normals: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W, 3) normals towards the camera -> (H, W) float32 cosine between normal and line of sight.

    1 where the surface is seen frontally, 0 where it is seen edge-on or its normal is unknown.
    """
    directions = unit_rays(camera)
    cosine: np.ndarray = -sum(normals[..., axis] * directions[..., axis] for axis in range(3))
    clipped: np.ndarray = np.clip(cosine, 0.0, 1.0)
    return clipped


def gradients(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float32 metres -> dD/dx and dD/dy, (H, W) float32 metres per pixel (3 x 3 Sobel / 8).

    0 next to holes and on the outermost pixels, where the window is not whole.
    """
    whole = cv2.erode(
        (depth > 0).astype(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    dx = cv2.Sobel(depth, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    dy = cv2.Sobel(depth, cv2.CV_32F, 0, 1, ksize=3, scale=1 / 8)
    return dx * whole, dy * whole


@functools.lru_cache(maxsize=4)
def unit_rays(camera: Camera) -> np.ndarray:
    """(H, W, 3) float32 unit vectors from the camera through each pixel centre (read-only)."""
    rays = camera.rays().numpy()
    unit: np.ndarray = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    unit.flags.writeable = False
    return unit


def _inverse(depth: np.ndarray, hole: float | np.float32) -> np.ndarray:
    """(H, W) float32 inverse depth in 1/m, `hole` where there is no measurement."""
    inverse = np.full(depth.shape, hole, np.float32)
    np.divide(np.float32(1.0), depth, out=inverse, where=depth > 0)
    return inverse


def _half_window(reach: int, step: int) -> list[tuple[int, int, float]]:
    """One tap (x, y, spatial weight) of each opposite pair of a window."""
    steps = range(-reach * step, reach * step + 1, step)
    taps = [(x, y) for y in steps for x in steps if (y, x) > (0, 0)]
    return [(x, y, float(np.exp(-(x * x + y * y) / (2 * SPATIAL_SIGMA**2)))) for x, y in taps]


_WINDOWS = tuple(_half_window(reach, step) for reach, step in PASSES)


def _smooth_inverse(inverse: np.ndarray, taps: list[tuple[int, int, float]], limit: float) -> np.ndarray:
    """One pass over (H, W) inverse depth. `limit` in 1/m is the support of the biweight range kernel, which resembles
    a Gaussian of a third of that width and is exactly 0 beyond."""
    height, width = inverse.shape
    rim = max(max(abs(x), abs(y)) for x, y, _ in taps)
    padded = cv2.copyMakeBorder(inverse, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=float(_HOLE))
    twice = inverse * np.float32(2.0)
    correction, total = np.zeros_like(inverse), np.ones_like(inverse)
    bend, weight = np.empty_like(inverse), np.empty_like(inverse)
    for x, y, spatial in taps:
        ahead = padded[rim + y : rim + y + height, rim + x : rim + x + width]
        behind = padded[rim - y : rim - y + height, rim - x : rim - x + width]
        np.add(ahead, behind, out=bend)
        np.subtract(bend, twice, out=bend)  # twice the distance from the centre to the mean of the pair
        np.multiply(bend, bend, out=weight)
        np.multiply(weight, np.float32(-0.25 / limit**2), out=weight)
        np.add(weight, np.float32(1.0), out=weight)
        np.maximum(weight, np.float32(0.0), out=weight)
        np.multiply(weight, weight, out=weight)
        np.multiply(weight, np.float32(spatial), out=weight)
        np.multiply(bend, weight, out=bend)
        np.add(correction, bend, out=correction)
        np.add(total, weight, out=total)
        np.add(total, weight, out=total)
    smoothed: np.ndarray = inverse + correction / total
    return smoothed


def _difference(inverse: np.ndarray, axis: int, max_slope: float, max_bend: float) -> np.ndarray:
    """Change of the inverse depth (nan = hole) per pixel along `axis`, within one surface; nan where there is none.

    `max_slope` is the largest change relative to the value, `max_bend` the largest disagreement in 1/m between both
    sides for a central difference; beyond it the flatter side is the surface of the pixel.
    """
    steps = np.diff(inverse, axis=axis)
    edge = np.full_like(np.take(inverse, [0], axis), np.nan)
    ahead = np.concatenate([steps, edge], axis)
    behind = np.concatenate([edge, steps], axis)
    limit = inverse * np.float32(max_slope)
    size_ahead, size_behind = np.abs(ahead), np.abs(behind)
    ahead_valid, behind_valid = size_ahead <= limit, size_behind <= limit  # false for nan
    use_ahead = ahead_valid & ~(behind_valid & (size_behind < size_ahead))
    one_sided = np.where(use_ahead, ahead, np.where(behind_valid, behind, np.float32(np.nan)))
    both = ahead_valid & behind_valid & (np.abs(ahead - behind) <= np.float32(max_bend))
    return np.where(both, np.float32(0.5) * (ahead + behind), one_sided)
