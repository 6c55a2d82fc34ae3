"""Weight of each sensor in the map: its share so far, and its reliability."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from ...core.config.map_config import MapConfig
from ...mvs.bias_model import BiasModel
from ...mvs.photometric_depth import PhotometricDepth
from ...mvs.sensor_reliability import DEFAULT_RELIABILITY, collect_samples, estimate_reliability
from ...sensors.fusion_weights import FusionWeights
from ...sensors.noise_model import NoiseModel
from ...volume.tsdf_volume import TsdfVolume


class WeightSums:
    """Total fusion weight of each sensor near the surface, up to a factor that all images share."""

    def __init__(self, sensors: tuple[str, ...], max_depth_m: float) -> None:
        self.sensors, self.max_depth_m = sensors, max_depth_m
        self.sums = dict.fromkeys(sensors, 0.0)

    def add(self, sensor: str, depth: Tensor, weight: Tensor | None, sign: float = 1.0) -> None:
        """Add an image: depth (H, W) metres, weight (H, W) or None = 1; with `sign` -1 it is subtracted.

        A pixel covers an area that grows with the square of its depth, and contributes to as many samples.
        """
        area = torch.where(depth < self.max_depth_m, depth, 0.0).square()
        self.sums[sensor] += sign * float((area if weight is None else area * weight).sum(dtype=torch.float64))

    def shares(self) -> dict[str, float]:
        """Share of each sensor in the weights that decide where the surface is; their sum is 1, or 0 without images."""
        total = sum(self.sums.values())
        return {sensor: weight / total if total > 0 else 0.0 for sensor, weight in self.sums.items()}

    def clear(self) -> None:
        """Start again from an empty map."""
        self.sums = dict.fromkeys(self.sensors, 0.0)

    def state_dict(self) -> dict[str, Any]:
        """Plain containers that `load_state_dict` continues from."""
        return {"sums": self.sums}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state of the same sensors."""
        self.sums = dict(state["sums"])


def sensor_reliability(
    photometric: PhotometricDepth,
    noise: Mapping[str, NoiseModel],
    biases: Mapping[str, BiasModel],
    volume: TsdfVolume,
    config: MapConfig,
) -> dict[str, float]:
    """Reliability by sensor: 1 without validated photometric depth, the default if it is not to be estimated."""
    sensors = tuple(noise)
    if not photometric.validated or photometric.samples is None:
        return dict.fromkeys(sensors, 1.0)
    if not config.photometric.estimate_reliability:
        return dict.fromkeys(sensors, DEFAULT_RELIABILITY)
    nominal = FusionWeights(config.fusion, sensors)  # with reliability 1
    samples = collect_samples(photometric.samples, noise, biases, nominal, volume.truncation_m)
    return estimate_reliability(
        samples, photometric.share_source_images(), volume.grid.voxel_size_m, photometric.samples.sensors
    )
