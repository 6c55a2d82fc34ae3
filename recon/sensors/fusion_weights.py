"""Fusion weights of measurements: inverse variance by beta, times the reliability of the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from ..core.config.uncle import FusionConfig
from ..volume.tsdf_volume import FreeSpace

WEIGHT_SCALE_M = 0.01  # a measurement with this beta has the weight 1
_MAX_FOR_MEDIAN = 20_000  # pixels of an image


@dataclass(frozen=True)
class FusionWeightParameters:
    """Constants of the fusion weights.

    min_relative_weight            lower bound of a sensor's weights, relative to their median in the image
    free_space_scale_betas         distance in front of the surface, in betas, on which free space becomes certain
    photometric_free_space_factor  on the free-space weight of photometric depth: only a band around the surface was
                                   searched
    """

    min_relative_weight: float = 0.5
    free_space_scale_betas: float = 2.0
    photometric_free_space_factor: float = 0.1


class FusionWeights:
    """Weights of the measurements of all sensors and of photometric depth.

    `reliability` by sensor: factor on its weights relative to photometric depth of the same beta.
    """

    def __init__(
        self,
        config: FusionConfig,
        sensors: tuple[str, ...],
        parameters: FusionWeightParameters = FusionWeightParameters(),
    ) -> None:
        self.discretisation_m = config.discretisation_voxels * config.voxel_size_m
        self.reliability = dict.fromkeys(sensors, 1.0)
        self.parameters = parameters

    def inverse_variance(self, beta: Tensor, sensor: str | None = None) -> Tensor:
        """beta (...) metres -> (...) weights of a sensor, None = photometric depth: inverse variance times reliability.

        The discretisation of the voxel grid adds to the noise of the sensor; without it the few measurements with the
        smallest beta would dominate all others.
        """
        factor = 1.0 if sensor is None else self.reliability[sensor]
        return factor * WEIGHT_SCALE_M**2 / (beta.square() + self.discretisation_m**2).clamp(min=1e-8)

    def for_sensor(self, beta: Tensor, valid: Tensor, sensor: str) -> tuple[Tensor, FreeSpace]:
        """beta (H, W) metres of an image and its `valid` pixels -> weights (H, W) and those of free space.

        The weights have a lower bound relative to their median: a silhouette is noisy in every view, and the steadier
        background behind it would erase it.
        """
        weight = self.inverse_variance(beta, sensor)
        median = median_weight(weight, valid)
        weight = weight.clamp(min=self.parameters.min_relative_weight * median)
        return weight, self._free_space(weight, median, beta)

    def for_photometric(self, beta: Tensor, valid: Tensor, frames: float) -> tuple[Tensor, FreeSpace]:
        """beta (H, W) metres of a view of photometric depth that stands for a number of `frames` -> as `for_sensor`."""
        weight = frames * self.inverse_variance(beta)
        free_space = self._free_space(weight, median_weight(weight, valid), beta)
        factor = self.parameters.photometric_free_space_factor
        return weight, FreeSpace(factor * free_space.weight, free_space.scale_m)

    def _free_space(self, weight: Tensor, median: float, beta: Tensor) -> FreeSpace:
        return FreeSpace.from_weight(weight, median, self.parameters.free_space_scale_betas * beta)


def median_weight(weight: Tensor, valid: Tensor) -> float:
    """Median weight (...) of the `valid` pixels, of evenly spread ones where there are many; 0 if there is none."""
    stride = 1 + weight.numel() // _MAX_FOR_MEDIAN | 1  # odd: not the same columns of each row
    chosen = weight.reshape(-1)[::stride][valid.reshape(-1)[::stride]].cpu().numpy()
    middle = (len(chosen) - 1) // 2
    return float(np.partition(chosen, middle)[middle]) if len(chosen) else 0.0
