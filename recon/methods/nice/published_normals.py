"""Normals, incidence and gradients exactly as UncLe-SLAM's released code computes them.

Used with `nice.reproduce_released_code` (docs/uncle-paper.md, differences 6 and 7). They differ from `core.normals` on
purpose: the bilateral filter has a range sigma of 100 m and so is a plain blur across edges and holes, differences are
forward, holes are not masked, normals point AWAY from the camera, the incidence is a signed cosine, and a unit slope
has the gradient 128 / 48. Images are (H, W) float32; depth is in metres, 0 where there is none.
"""

from __future__ import annotations

import cv2
import numpy as np

from ...core.camera import Camera
from ...core.normals import unit_rays

# Constants of the released code.
DIAMETER = 9  # pixels
RANGE_SIGMA = 100.0  # metres
SPATIAL_SIGMA = 9.0  # pixels
SOBEL_DIVISOR = 48.0
EPSILON = 1e-9


def smooth_depth(depth: np.ndarray) -> np.ndarray:
    """(H, W) float32 metres -> (H, W) float32 metres, holes blurred into what is around them."""
    return cv2.bilateralFilter(depth, DIAMETER, RANGE_SIGMA, SPATIAL_SIGMA)


def normals(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W) float32 smoothed metres -> (H, W, 3) unit normals away from the camera, 0 on the outermost pixels."""
    points = camera.rays().numpy() * depth[..., None]
    x_step = points[1:-1, 2:] - points[1:-1, 1:-1]
    y_step = points[2:, 1:-1] - points[1:-1, 1:-1]
    directions = np.cross(x_step, y_step)
    result = np.zeros_like(points)
    result[1:-1, 1:-1] = directions / (np.linalg.norm(directions, axis=-1, keepdims=True) + EPSILON)
    return result


def incidence(normals: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W, 3) normals away from the camera -> (H, W) float32 signed cosine, near 1 where frontal."""
    return (normals * unit_rays(camera)).sum(axis=-1)


def gradients(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float32 metres, not smoothed -> dD/dx and dD/dy, (H, W) float32 (5 x 5 Sobel / 48)."""
    dx = cv2.Sobel(depth, cv2.CV_32F, 1, 0, ksize=5, scale=1 / SOBEL_DIVISOR)
    dy = cv2.Sobel(depth, cv2.CV_32F, 0, 1, ksize=5, scale=1 / SOBEL_DIVISOR)
    return dx, dy
