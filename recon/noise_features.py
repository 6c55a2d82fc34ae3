"""What the uncertainty network sees of a pixel: numbers from the sensor's own image, none from the map.

The paper feeds a 5 x 5 patch of depth and incidence. Here the neighbourhood is summarised instead, at three scales:
a disparity sensor's errors follow the spread of inverse depth, holes, edges, and (for stereo) the texture at hand.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from torch import Tensor

from .camera import Camera
from .features import incidence

WINDOWS = (3, 7, 15)  # pixels
FEATURES = (
    "depth", "incidence", *(f"{kind}_{window}" for window in WINDOWS for kind in ("spread", "offset", "holes")),
    "bend", "slope_x", "slope_y", "texture_x_5", "texture_x_21", "contrast", "brightness", "image_x", "image_y",
)  # fmt: skip


def noise_features(depth: Tensor, normals: Tensor, color: Tensor, camera: Camera) -> Tensor:
    """depth (H, W) metres, normals (H, W, 3), color (H, W, 3) uint8 -> (H, W, F) float32 of order 1, F = len(FEATURES).

    Logarithms of spreads, clipped, so that no scale has to be learned and a model carries over to other recordings.
    """
    metres = depth.numpy()
    valid = (metres > 0).astype(np.float32)
    inverse = np.divide(1.0, metres, out=np.zeros_like(metres), where=metres > 0)
    grey = cv2.cvtColor(color.numpy(), cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    planes = [metres / 3, incidence(normals.numpy(), camera) * 2 - 1]
    for window in WINDOWS:
        planes += _neighbourhood(inverse, valid, window)
    planes.append(_log(_box(np.abs(cv2.Laplacian(inverse, cv2.CV_32F, ksize=3)), 5), 1e-4))
    planes += [np.clip(50 * _slope(inverse, axis), -3, 3) for axis in (0, 1)]
    texture = np.abs(_slope(grey, 0))
    planes += [_log(_box(texture, 5), 1e-3), _log(_box(texture, 21), 1e-3)]
    mean = _box(grey, 7)
    planes.append(_log(np.sqrt(np.maximum(_box(grey * grey, 7) - mean * mean, 0)), 1e-3))
    u = (np.arange(camera.width, dtype=np.float32) - camera.cx) / camera.width
    v = (np.arange(camera.height, dtype=np.float32) - camera.cy) / camera.height
    planes += [grey - 0.5, np.broadcast_to(u, metres.shape), np.broadcast_to(v[:, None], metres.shape)]
    return torch.from_numpy(np.stack(planes).astype(np.float32, copy=False)).permute(1, 2, 0)  # each plane in one piece


def _neighbourhood(inverse: np.ndarray, valid: np.ndarray, window: int) -> list[np.ndarray]:
    """Spread of the inverse depth around a pixel, its own offset from the mean, and the share of holes."""
    share = np.maximum(_box(valid, window), 1e-6)
    mean = _box(inverse, window) / share
    spread = np.sqrt(np.maximum(_box(inverse * inverse, window) / share - mean * mean, 0))
    return [_log(spread, 1e-4), np.clip(20 * (inverse - mean), -3, 3), 1 - share]


def _box(image: np.ndarray, window: int) -> np.ndarray:
    return cv2.blur(image, (window, window), borderType=cv2.BORDER_REPLICATE)


def _slope(image: np.ndarray, axis: int) -> np.ndarray:
    return cv2.Sobel(image, cv2.CV_32F, 1 - axis, axis, ksize=3, scale=1 / 8)


def _log(values: np.ndarray, floor: float) -> np.ndarray:
    """log10 of `values` + `floor`, shifted so that 30 floors give about 0."""
    return np.log10(values + np.float32(floor)) - np.float32(np.log10(floor) + 1.5)
