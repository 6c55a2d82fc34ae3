"""Fusion weights of measurements: inverse variance by beta, times the reliability of the sensor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from torch import Tensor

from ..core.config.uncle import FusionConfig
from ..volume.tsdf_volume import FreeSpace

WEIGHT_SCALE_M = 0.01  # a reading with this beta weighs 1
MIN_RELATIVE_WEIGHT = 0.5  # of the median weight of the image
FREE_SPACE_SCALE_BETAS = 2.0  # a reading vouches for free space on the scale of this many betas before it
PHOTOMETRIC_FREE_SPACE_FACTOR = (
    0.1  # of its weight: colour is compared around the surface only, what is far before it was not tried
)
_ENOUGH_READINGS = 20_000  # for a median


class FusionWeights:
    """`reliability` by sensor: factor on its weights relative to photometric depth of the same beta."""

    def __init__(self, config: FusionConfig, sensors: tuple[str, ...]) -> None:
        self.blur_m = config.discretisation_voxels * config.voxel_size_m
        self.reliability = dict.fromkeys(sensors, 1.0)

    def inverse_variance(self, beta: Tensor, sensor: str | None = None) -> Tensor:
        """beta (...) metres -> (...) fusion weight of a sensor, None = photometric depth: inverse variance on this map,
        times the reliability.

        The discretisation of the voxel grid adds to the noise of the sensor; without it the few measurements with the
        smallest beta would dominate all others.
        """
        factor = 1.0 if sensor is None else self.reliability[sensor]
        return factor * WEIGHT_SCALE_M**2 / (beta.square() + self.blur_m**2).clamp(min=1e-8)

    def for_sensor(self, beta: Tensor, valid: Tensor, sensor: str) -> tuple[Tensor, FreeSpace]:
        """beta (...) metres of an image -> what its readings weigh, none below `MIN_RELATIVE_WEIGHT` of their median.

        A silhouette is noisy in every view; without a floor the steadier background behind it would outvote it away.
        """
        weight = self.inverse_variance(beta, sensor)
        typical = median_weight(weight, valid)
        weight = weight.clamp(min=MIN_RELATIVE_WEIGHT * typical)
        return weight, FreeSpace.of(weight, typical, FREE_SPACE_SCALE_BETAS * beta)

    def for_photometric(self, beta: Tensor, valid: Tensor, frames: float) -> tuple[Tensor, FreeSpace]:
        """beta (...) metres of a view of colour that stands for a number of `frames` -> what its readings weigh."""
        weight = frames * self.inverse_variance(beta)
        free_space = FreeSpace.of(weight, median_weight(weight, valid), FREE_SPACE_SCALE_BETAS * beta)
        return weight, replace(free_space, weight=PHOTOMETRIC_FREE_SPACE_FACTOR * free_space.weight)


def median_weight(weight: Tensor, valid: Tensor) -> float:
    """Median weight (...) of the `valid` readings, of evenly spread ones where there are many; 0 if there is none."""
    stride = 1 + weight.numel() // _ENOUGH_READINGS | 1  # odd: not the same columns of each row
    chosen = weight.reshape(-1)[::stride][valid.reshape(-1)[::stride]].cpu().numpy()
    middle = (len(chosen) - 1) // 2
    return float(np.partition(chosen, middle)[middle]) if len(chosen) else 0.0
