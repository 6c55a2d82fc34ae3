"""What the uncertainty network sees of a pixel: numbers from the sensor's own image, none from the map.

The paper feeds a 5 x 5 patch of depth and incidence. Here the neighbourhood is summarised instead, at three scales:
a disparity sensor's errors follow the spread of inverse depth, holes, edges, and (for stereo) the texture at hand.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
from numba import njit
from torch import Tensor

from ..core.camera import Camera
from ..core.normals import incidence

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
    planes = np.empty((len(FEATURES), *metres.shape), np.float32)  # each plane in one piece
    plane = dict(zip(FEATURES, planes, strict=True))
    np.divide(metres, 3, out=plane["depth"])
    np.subtract(incidence(normals.numpy(), camera) * 2, 1, out=plane["incidence"])
    for window in WINDOWS:
        _neighbourhood(inverse, valid, window, *(plane[f"{kind}_{window}"] for kind in ("spread", "offset", "holes")))
    _log(_box(np.abs(cv2.Laplacian(inverse, cv2.CV_32F, ksize=3)), 5), 1e-4, plane["bend"])
    for axis, name in enumerate(("slope_x", "slope_y")):
        np.clip(50 * _slope(inverse, axis), -3, 3, out=plane[name])
    texture = np.abs(_slope(grey, 0))
    _log(_box(texture, 5), 1e-3, plane["texture_x_5"])
    _log(_box(texture, 21), 1e-3, plane["texture_x_21"])
    mean = _box(grey, 7)
    _log(np.sqrt(np.maximum(_box(grey * grey, 7) - mean * mean, 0)), 1e-3, plane["contrast"])
    np.subtract(grey, 0.5, out=plane["brightness"])
    plane["image_x"][:] = (np.arange(camera.width, dtype=np.float32) - camera.cx) / camera.width
    plane["image_y"][:] = ((np.arange(camera.height, dtype=np.float32) - camera.cy) / camera.height)[:, None]
    return torch.from_numpy(planes).permute(1, 2, 0)


def relative_spread(features: Tensor) -> Tensor:
    """(..., F) -> (...) spread of the depth in 7 x 7 pixels around, as a share of the depth: large at its edges."""
    inverse = 10 ** (features[..., FEATURES.index("spread_7")] + 1.5) * 1e-4 - 1e-4
    return inverse.clamp(min=0) * features[..., FEATURES.index("depth")] * 3


def _neighbourhood(
    inverse: np.ndarray, valid: np.ndarray, window: int, spread: np.ndarray, offset: np.ndarray, holes: np.ndarray
) -> None:
    """Spread of the inverse depth around a pixel, its own offset from the mean, and the share of holes, into (H, W)."""
    means = (_box(image, window) for image in (valid, inverse, inverse * inverse))
    _summarise(inverse.ravel(), *(image.ravel() for image in (*means, spread, offset, holes)))
    _log(spread, 1e-4, spread)


@njit(nogil=True, cache=True)
def _summarise(inverse, share, mean, square, spread, offset, holes):
    """Images (N,); `share` of readings, `mean` and mean `square` of all pixels in the window, holes counting as 0."""
    few, most, nothing, one = np.float32(1e-6), np.float32(3), np.float32(0), np.float32(1)
    for pixel in range(len(inverse)):
        seen = max(share[pixel], few)
        middle = mean[pixel] / seen
        spread[pixel] = np.sqrt(max(square[pixel] / seen - middle * middle, nothing))
        offset[pixel] = min(max(np.float32(20) * (inverse[pixel] - middle), -most), most)
        holes[pixel] = one - seen


def _box(image: np.ndarray, window: int) -> np.ndarray:
    return cv2.blur(image, (window, window), borderType=cv2.BORDER_REPLICATE)


def _slope(image: np.ndarray, axis: int) -> np.ndarray:
    return cv2.Sobel(image, cv2.CV_32F, 1 - axis, axis, ksize=3, scale=1 / 8)


def _log(values: np.ndarray, floor: float, out: np.ndarray) -> None:
    """log10 of `values` + `floor`, shifted so that 30 floors give about 0, into `out`."""
    np.add(values, np.float32(floor), out=out)
    np.log10(out, out=out)
    out -= np.float32(np.log10(floor) + 1.5)
