"""Simulated active depth sensors: functions of a true depth image and a random generator.

Depth images are (H, W) float32 metres along the optical axis, 0 = no measurement, before and after. docs/synth.md names
the sources and what is not simulated.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import distance_transform_edt

# Structured light after Handa et al.: focal length 480 px, baseline 0.075 m.
_HANDA_FOCAL_PX = 480.0
_HANDA_FB = 36.0
_KINECT_DISPARITY = 35130.0  # raw disparity times centimetres
_REDWOOD_DISPARITY = 35.13  # the same in metres and in pixels
_MATCH_HALF_PX = 4  # half of a 9 x 9 window
_MATCH_TOLERANCE_PX = 0.1
_MATCH_SHARE = 1 / 1.2
_DOT_SHARE = 0.11
_SPREAD_PX = 3


def dot_pattern(height: int, width: int, share: float = _DOT_SHARE, seed: int = 7) -> np.ndarray:
    """(H, W) bool: pixels lit by the projector. A random stand-in: the pattern of the real device is not published."""
    return np.random.default_rng(seed).uniform(size=(height, width)) < share


def structured_light_handa(
    depth: np.ndarray, rng: np.random.Generator, focal_px: float = _HANDA_FOCAL_PX
) -> np.ndarray:
    """Structured light after Handa et al. (ICL-NUIM) with speckle matching; quantisation step z^2 / 351 m.

    1. pixel shift N(0, 0.5^2), bilinear; 2. disparity rounded to 1/8; 3. matching of a dot pattern in 9 x 9 windows;
    4. raw disparity 35130 / z_cm with noise N(0, (1/6)^2), rounded half up. Widespread code rounds to nearest after
    adding the half, which shortens every depth by half a step; here the half is added once. Pixels are those of the
    device, 480 to the focal length: for a coarser image (`focal_px` < 480) every length in the image shrinks with it.
    """
    scale = min(1.0, focal_px / _HANDA_FOCAL_PX)
    shifted = _shifted_bilinear(depth, rng, 0.5 * scale)
    valid = shifted > 0
    disparity = np.where(valid, np.round(8 * _HANDA_FB / np.where(valid, shifted, 1)) / 8, 0)
    height, width = depth.shape
    dots = dot_pattern(height, width, share=min(1.0, _DOT_SHARE / scale**2))
    matched = _match_dots(disparity, dots, scale)
    matched_ok = matched > 0
    z_cm = np.round(100 * _HANDA_FB / np.where(matched_ok, matched, 1))
    raw = _KINECT_DISPARITY / np.maximum(z_cm, 1)
    raw = np.floor(raw + rng.normal(0, 1 / 6, depth.shape) + 0.5)
    result = _KINECT_DISPARITY / np.maximum(raw, 1) / 100
    return np.where(matched_ok & (raw >= 1), result, 0).astype(np.float32)


def structured_light_redwood(depth: np.ndarray, rng: np.random.Generator, multiplier: float = 1.0) -> np.ndarray:
    """The Redwood noise model as used by Habitat, without its lens distortion table, which is not available.

    1. pixel shift N(0, 0.25^2), nearest; 2. the even-coordinate pixel is read, no measurement at 10 m and beyond;
    4. q = round(8 (35.13 / z + N(0, (multiplier / 36)^2))), z' = 35.13 * 8 / q.
    """
    height, width = depth.shape
    v, u = np.mgrid[:height, :width]
    u = np.rint(np.clip(u + rng.normal(0, 0.25, depth.shape), 0, width - 1)).astype(int)
    v = np.rint(np.clip(v + rng.normal(0, 0.25, depth.shape), 0, height - 1)).astype(int)
    z = depth[v - v % 2, u - u % 2]
    valid = (z > 0) & (z < 10)
    q = np.round(8 * (_REDWOOD_DISPARITY / np.where(valid, z, 1) + rng.normal(0, multiplier / 36, depth.shape)))
    return np.where(valid & (q > 0), _REDWOOD_DISPARITY * 8 / np.maximum(q, 1), 0).astype(np.float32)


def time_of_flight(depth: np.ndarray, rng: np.random.Generator, focal_px: float) -> np.ndarray:
    """A time-of-flight-like camera; a plausible model of our own, not of one device.

    Noise 2 mm + 1.5 mm z^2, divided by the cosine of incidence; flying pixels between the two depths of an edge;
    surfaces in concave corners up to 4 cm too far (multipath); no measurement at grazing incidence or beyond 7 m.
    """
    valid = depth > 0
    normals = depth_normals(depth, focal_px)
    rays = _rays(depth.shape, focal_px)
    cosine = np.abs(np.einsum("ijk,ijk->ij", normals, rays)) / np.linalg.norm(rays, axis=-1)
    sigma = (0.002 + 0.0015 * depth**2) / np.maximum(cosine, 0.2)
    reading = depth + 0.04 * _concavity(depth, normals, rays, focal_px) + sigma * rng.normal(size=depth.shape)
    mask = np.where(valid, depth, np.inf).astype(np.float32)
    near = cv2.erode(mask, np.ones((3, 3), np.uint8))
    far = cv2.dilate(np.where(valid, depth, 0).astype(np.float32), np.ones((3, 3), np.uint8))
    edge = valid & (far - near > 0.05 + 0.05 * depth) & (cosine > 0)
    flying = edge & (rng.uniform(size=depth.shape) < 0.6)
    share = rng.beta(0.7, 0.7, depth.shape)
    reading = np.where(flying, near * share + far * (1 - share), reading)
    lost = (cosine < 0.12) | (depth > 7.0) | (edge & (rng.uniform(size=depth.shape) < 0.1))
    return np.where(valid & ~lost, np.maximum(reading, 0.05), 0).astype(np.float32)


def depth_normals(depth: np.ndarray, focal_px: float) -> np.ndarray:
    """(H, W, 3) unit normals in camera axes from the smaller one-sided differences; 0 where a neighbour is missing."""
    points = _rays(depth.shape, focal_px) * depth[..., None]
    tangents = []
    for axis in (1, 0):
        step = np.diff(points, axis=axis)
        last, first = np.take(step, [-1], axis), np.take(step, [0], axis)
        ahead, behind = np.concatenate([step, last], axis), np.concatenate([first, step], axis)
        nearer = np.abs(ahead[..., 2]) < np.abs(behind[..., 2])
        tangents.append(np.where(nearer[..., None], ahead, behind))
    normals = np.cross(tangents[1], tangents[0])
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    known = (depth > 0)[..., None] & (length > 1e-12)
    return np.where(known, normals / np.maximum(length, 1e-12), 0).astype(np.float32)


def _rays(shape: tuple[int, int], focal_px: float) -> np.ndarray:
    """(H, W, 3) float32 directions with z = 1; the principal point is the centre of the image."""
    v, u = np.mgrid[: shape[0], : shape[1]]
    x, y = (u - (shape[1] - 1) / 2) / focal_px, (v - (shape[0] - 1) / 2) / focal_px
    return np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float32)


def _concavity(depth: np.ndarray, normals: np.ndarray, rays: np.ndarray, focal_px: float) -> np.ndarray:
    """(H, W) 0..1: how much of the surface around a pixel stands in front of its tangent plane."""
    points = rays * depth[..., None]
    height, width = depth.shape
    total = np.zeros(depth.shape, dtype=np.float32)
    reach = max(2, round(0.06 * focal_px))
    padded = np.pad(points, ((reach, reach), (reach, reach), (0, 0)), mode="edge")
    offsets = [(dy, dx) for dy in (0, reach, 2 * reach) for dx in (0, reach, 2 * reach) if (dy, dx) != (reach, reach)]
    facing = -np.sign(np.einsum("ijk,ijk->ij", rays, normals))
    for dy, dx in offsets:
        other = padded[dy : dy + height, dx : dx + width]
        away = other - points
        rise = np.einsum("ijk,ijk->ij", away, normals) * facing
        length = np.linalg.norm(away, axis=-1)
        near = (other[..., 2] > 0) & (length < 0.6)
        total += np.where(near, np.clip(rise / np.maximum(length, 1e-6), 0, 1), 0)
    return np.clip(cv2.GaussianBlur(total / 3, (0, 0), 2.0), 0, 1)


def _shifted_bilinear(depth: np.ndarray, rng: np.random.Generator, sigma: float) -> np.ndarray:
    """The image read beside each pixel; 0 where one of the four pixels read holds nothing."""
    height, width = depth.shape
    v, u = np.mgrid[:height, :width]
    u = np.clip(u + rng.normal(0, sigma, depth.shape), 0, width - 1)
    v = np.clip(v + rng.normal(0, sigma, depth.shape), 0, height - 1)
    u0, v0 = np.minimum(u.astype(int), width - 2), np.minimum(v.astype(int), height - 2)
    a, b = u - u0, v - v0
    corners = [depth[v0, u0], depth[v0, u0 + 1], depth[v0 + 1, u0], depth[v0 + 1, u0 + 1]]
    value = (corners[0] * (1 - a) + corners[1] * a) * (1 - b) + (corners[2] * (1 - a) + corners[3] * a) * b
    return np.where(np.minimum.reduce(corners) > 0, value, 0)


def _match_dots(disparity: np.ndarray, dots: np.ndarray, scale: float) -> np.ndarray:
    """(H, W) disparities where the dots of a window agree, spread to the gaps between dots; 0 elsewhere."""
    half = max(1, round(_MATCH_HALF_PX * scale))
    side = 2 * half + 1
    rows, cols = np.nonzero(dots[half:-half, half:-half])
    windows = sliding_window_view(disparity.astype(np.float32), (side, side))[rows, cols].reshape(-1, side * side)
    lit = sliding_window_view(dots, (side, side))[rows, cols].reshape(-1, side * side)
    offsets = np.arange(-half, half + 1) / scale  # in pixels of the device
    square = (offsets[:, None] ** 2 + offsets[None] ** 2).ravel()
    tolerance = (_MATCH_TOLERANCE_PX * np.where(square > 0, 1.44 * square, 1)).astype(np.float32)
    valid = windows > 0
    mean = windows.sum(axis=1) / np.maximum(valid.sum(axis=1), 1)
    agree = valid & (np.abs(windows - mean[:, None]) < tolerance)
    center = windows[:, len(square) // 2]
    accepted = (center > 0) & ((lit & agree).sum(axis=1) > lit.sum(axis=1) * _MATCH_SHARE)
    known = np.zeros(disparity.shape, dtype=bool)
    known[rows[accepted] + half, cols[accepted] + half] = True
    if not known.any():
        return np.zeros_like(disparity)
    # The weight 1 / (1 + r^2) of a dot makes the nearest accepted dot win.
    distance, (v, u) = distance_transform_edt(~known, return_indices=True)
    return np.where(distance <= max(1.0, _SPREAD_PX * scale), disparity[v, u], 0)
