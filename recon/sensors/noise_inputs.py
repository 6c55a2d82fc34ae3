"""The inputs of a sensor's noise model at a pixel: numbers from the sensor's own image and the colour, not the map.

UncLe-SLAM uses a 5 x 5 patch of depth and incidence. Here the neighbourhood is summarised at three scales instead: the
errors of a disparity sensor follow the spread of inverse depth, holes, edges and, for stereo, the local texture.
The encodings are part of the files of noise models: a change of one makes earlier files useless (`SENSOR_INPUTS` is
compared when a file is read, the encodings are not).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.compiled import compiled
from ..core.normals import incidence

WINDOWS = (3, 7, 15)  # pixels
SENSOR_INPUTS = (
    "depth", "incidence", *(f"{kind}_{window}" for window in WINDOWS for kind in ("spread", "offset", "holes")),
    "bend", "slope_x", "slope_y", "texture_x_5", "texture_x_21", "contrast", "brightness", "image_x", "image_y",
)  # fmt: skip
DEPTH_UNIT_M = 3
SLOPE_GAIN = 50  # of the inverse depth per pixel, 1 / metres
MAX_ENCODED = 3  # of slopes and offsets


@dataclass(frozen=True)
class LogEncoding:
    """log10 of a positive number + `floor`, shifted so that about 30 floors become 0."""

    floor: float

    _SHIFT = 1.5  # log10 of 30

    def encode(self, values: np.ndarray, out: np.ndarray) -> None:
        """`values` (...) into `out` (...), which may be the same array."""
        np.add(values, np.float32(self.floor), out=out)
        np.log10(out, out=out)
        out -= np.float32(np.log10(self.floor) + self._SHIFT)

    def decode(self, encoded: Tensor) -> Tensor:
        """The inverse of `encode`."""
        values: Tensor = 10 ** (encoded + self._SHIFT) * self.floor - self.floor
        return values


INVERSE_DEPTH = LogEncoding(1e-4)  # 1 / metres
GREY = LogEncoding(1e-3)  # of 0..1


def pixel_inputs(depth: Tensor, normals: Tensor, color: Tensor, camera: Camera) -> Tensor:
    """depth (H, W) metres, normals (H, W, 3), color (H, W, 3) uint8 -> (H, W, F) float32, F = len(SENSOR_INPUTS).

    All are of order 1, so that no scale has to be learned and a model carries over to other recordings.
    """
    metres = depth.numpy()
    valid = (metres > 0).astype(np.float32)
    inverse = np.divide(1.0, metres, out=np.zeros_like(metres), where=metres > 0)
    grey = cv2.cvtColor(color.numpy(), cv2.COLOR_RGB2GRAY).astype(np.float32) / 255
    planes = np.empty((len(SENSOR_INPUTS), *metres.shape), np.float32)  # each plane in one piece
    plane = dict(zip(SENSOR_INPUTS, planes, strict=True))
    np.divide(metres, DEPTH_UNIT_M, out=plane["depth"])
    np.subtract(incidence(normals.numpy(), camera) * 2, 1, out=plane["incidence"])
    for window in WINDOWS:
        _neighbourhood(inverse, valid, window, *(plane[f"{kind}_{window}"] for kind in ("spread", "offset", "holes")))
    INVERSE_DEPTH.encode(_box(np.abs(cv2.Laplacian(inverse, cv2.CV_32F, ksize=3)), 5), plane["bend"])
    for axis, name in enumerate(("slope_x", "slope_y")):
        np.clip(SLOPE_GAIN * _slope(inverse, axis), -MAX_ENCODED, MAX_ENCODED, out=plane[name])
    texture = np.abs(_slope(grey, 0))
    GREY.encode(_box(texture, 5), plane["texture_x_5"])
    GREY.encode(_box(texture, 21), plane["texture_x_21"])
    mean = _box(grey, 7)
    GREY.encode(np.sqrt(np.maximum(_box(grey * grey, 7) - mean * mean, 0)), plane["contrast"])
    np.subtract(grey, 0.5, out=plane["brightness"])
    plane["image_x"][:] = (np.arange(camera.width, dtype=np.float32) - camera.cx) / camera.width
    plane["image_y"][:] = ((np.arange(camera.height, dtype=np.float32) - camera.cy) / camera.height)[:, None]
    return torch.from_numpy(planes).permute(1, 2, 0)


def relative_spread(inputs: Tensor) -> Tensor:
    """(..., F) -> (...) spread of the depth in the 7 x 7 pixels around, relative to the depth: large at its edges."""
    inverse = INVERSE_DEPTH.decode(inputs[..., SENSOR_INPUTS.index("spread_7")])
    return inverse.clamp(min=0) * inputs[..., SENSOR_INPUTS.index("depth")] * DEPTH_UNIT_M


def _neighbourhood(
    inverse: np.ndarray, valid: np.ndarray, window: int, spread: np.ndarray, offset: np.ndarray, holes: np.ndarray
) -> None:
    """Spread of the inverse depth around a pixel, its offset from the mean, and the ratio of holes, into (H, W)."""
    means = (_box(image, window) for image in (valid, inverse, inverse * inverse))
    _summarise(inverse.ravel(), *(image.ravel() for image in (*means, spread, offset, holes)))
    INVERSE_DEPTH.encode(spread, spread)


@compiled()
def _summarise(
    inverse: np.ndarray, ratio: np.ndarray, mean: np.ndarray, square: np.ndarray, spread: np.ndarray,
    offset: np.ndarray, holes: np.ndarray,
) -> None:  # fmt: skip
    """Images (N,); `ratio` of measured pixels, `mean` and mean `square` of all in the window, holes counting as 0."""
    few, most, nothing, one = np.float32(1e-6), np.float32(MAX_ENCODED), np.float32(0), np.float32(1)
    for pixel in range(len(inverse)):
        measured = max(ratio[pixel], few)
        middle = mean[pixel] / measured
        spread[pixel] = np.sqrt(max(square[pixel] / measured - middle * middle, nothing))
        offset[pixel] = min(max(np.float32(20) * (inverse[pixel] - middle), -most), most)
        holes[pixel] = one - measured


def _box(image: np.ndarray, window: int) -> np.ndarray:
    return cv2.blur(image, (window, window), borderType=cv2.BORDER_REPLICATE)


def _slope(image: np.ndarray, axis: int) -> np.ndarray:
    return cv2.Sobel(image, cv2.CV_32F, 1 - axis, axis, ksize=3, scale=1 / 8)
