"""What the depth images of one sensor show by themselves: range, fill and pixel noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from torch import Tensor

from ..core.errors import DataError

_VALUES = 2000  # pixels of an image that take part in the quantiles


class DepthImages(Protocol):
    """Depth images in metres by index and sensor."""

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement. Raises DataError."""


@dataclass(frozen=True)
class DepthFacts:
    """Of one sensor.

    quantiles   5, 50 and 95 % of its depth, metres
    noise_m     standard deviation of neighbouring pixels about a plane, metres; nothing of errors that they share
    fill        share of pixels with a measurement in a usual image
    empty       images without any, among the `images` that were tried
    """

    quantiles: tuple[float, float, float]
    noise_m: float
    fill: float
    empty: int
    images: int


def depth_facts(
    frames: DepthImages, sensor: str, indices: Sequence[int], max_depth_m: float = np.inf
) -> DepthFacts | None:
    """Facts of the depth images `indices`, of measurements up to `max_depth_m`; None if there is no measurement."""
    values, fills, noise = [], [], []
    for index in indices:
        try:
            depth = frames.depth(index, sensor).numpy()
        except DataError:
            fills.append(0.0)
            continue
        depth = np.where(depth <= max_depth_m, depth, 0.0)
        known = depth[depth > 0]
        fills.append(len(known) / depth.size)
        values.append(known[:: max(1, len(known) // _VALUES)])
        noise.append(pixel_noise(depth))
    joined = np.concatenate(values) if values else np.zeros(0)
    if not len(joined):
        return None
    low, middle, high = (float(q) for q in np.quantile(joined, (0.05, 0.5, 0.95)))
    measured = [one for one in noise if np.isfinite(one)]
    return DepthFacts(
        (low, middle, high),
        float(np.median(measured)) if measured else 0.0,
        float(np.median(fills)),
        sum(fill == 0.0 for fill in fills),
        len(fills),
    )


def pixel_noise(depth: np.ndarray) -> float:
    """Standard deviation of the noise of single pixels of (H, W) depth, in its unit; NaN without three in a row.

    The median of second differences along rows, which vanish on a plane: a sensor that smooths has 0.
    """
    known = (depth[:, :-2] > 0) & (depth[:, 1:-1] > 0) & (depth[:, 2:] > 0)
    if not known.any():
        return float("nan")
    second = (depth[:, :-2] - 2 * depth[:, 1:-1] + depth[:, 2:])[known]
    return float(np.median(np.abs(second)) / (0.6745 * np.sqrt(6.0)))
