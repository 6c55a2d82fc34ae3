"""Integration of posed frames into the volume, weighted by the noise model of each sensor."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.map_config import MapConfig
from ...core.frame import Frame
from ...mvs.photometric_samples import PhotometricDepthImage
from ...sensors.fusion_weights import FusionWeights
from ...sensors.noise_model import NoiseModel
from ...volume.sparse_grid import SparseGrid
from ...volume.tsdf_surface import TsdfSurface
from ...volume.tsdf_volume import FreeSpace, TsdfVolume
from .fusion_log import FusionLog
from .sensor_weighting import WeightSums


class Mapper:
    """The volume under construction.

    noise: model of each sensor, trained elsewhere; empty = every measurement weighs the same. weights: fusion weights
    from beta and sensor reliability; weight_sums: total weight per sensor; log: how frames were integrated, recorded
    while poses can still change.
    """

    def __init__(
        self,
        camera: Camera,
        sensors: tuple[str, ...],
        config: MapConfig,
        noise: Mapping[str, NoiseModel],
        device: torch.device,
    ) -> None:
        fusion = config.fusion
        self.config, self.device = config, device
        self.noise = dict(noise) if config.uncertainty.enabled else {}
        truncation_m = fusion.truncation_voxels * fusion.voxel_size_m
        self.volume = TsdfVolume(SparseGrid(fusion.voxel_size_m, device), camera, truncation_m, fusion.max_depth_m)
        self.weights = FusionWeights(fusion, sensors)
        self.weight_sums = WeightSums(sensors, fusion.max_depth_m)
        self.log = FusionLog()
        self._surface: TsdfSurface | None = None  # cache, until the volume changes

    @property
    def is_empty(self) -> bool:
        """Whether no frame allocated any block yet."""
        return not self.volume.grid.rows

    # --- frames ------------------------------------------------------------------------------------------------
    def allocate(self, frame: Frame, T_world_camera: Tensor) -> None:
        """Allocate the blocks around all measurements of a frame."""
        self._surface = None
        for depth in frame.depths.values():
            self.volume.allocate(depth.to(self.device), T_world_camera)

    def integrate(self, frame: Frame, inputs: Mapping[str, Tensor], T_world_camera: Tensor) -> None:
        """Integrate all sensors of a frame into allocated blocks. `inputs` (H, W, F) of the noise models, by sensor."""
        if self.config.tracking.enabled:
            self.log.add(frame.index, T_world_camera, self.noise, len(self.volume.grid.blocks))
        self._surface = None
        color = frame.color.to(self.device)
        for sensor, image in frame.depths.items():
            depth = image.to(self.device)
            weight, free_space = self._weight(sensor, depth, inputs, self.noise)
            self.volume.integrate(depth, weight, color, T_world_camera, free_space)
            self.weight_sums.add(sensor, depth, weight)

    def deintegrate(self, frame: Frame, inputs: Mapping[str, Tensor]) -> None:
        """Subtract a frame with the pose and weights that it was integrated with."""
        record = self.log.records[frame.index]
        noise = self.log.noise_models(record, self.noise)
        self._surface = None
        color = frame.color.to(self.device)
        for sensor, image in frame.depths.items():
            depth = image.to(self.device)
            weight, free_space = self._weight(sensor, depth, inputs, noise)
            self.volume.deintegrate(depth, weight, color, record.T_world_camera, free_space, record.block_count)
            self.weight_sums.add(sensor, depth, weight, sign=-1.0)
        self.volume.clear_empty()

    def reintegrate(self, frame: Frame, inputs: Mapping[str, Tensor], T_world_camera: Tensor) -> None:
        """De-integrate a frame with the pose and weights it was integrated with, then integrate it at its new pose."""
        self.deintegrate(frame, inputs)
        self.allocate(frame, T_world_camera)
        self.integrate(frame, inputs, T_world_camera)

    def integrate_photometric(self, images: Iterable[PhotometricDepthImage], frames_per_view: float) -> None:
        """Integrate photometric depth; each view weighs as much as the frames that it stands for."""
        for image in images:
            self._surface = None
            depth, beta, pose = (t.to(self.device) for t in (image.depth, image.beta, image.T_world_camera))
            weight, free_space = self.weights.for_photometric(beta, depth > 0, frames_per_view)
            self.volume.allocate(depth, pose)
            self.volume.integrate(depth, weight, None, pose, free_space)

    def _weight(
        self, sensor: str, depth: Tensor, inputs: Mapping[str, Tensor], noise: Mapping[str, NoiseModel]
    ) -> tuple[Tensor, FreeSpace] | tuple[None, None]:
        """Fusion weight (H, W) of an image, and that of the free space in front of it."""
        if not noise:
            return None, None
        beta = noise[sensor].beta_image(depth, inputs[sensor].to(self.device))
        return self.weights.for_sensor(beta, depth > 0, sensor)

    # --- the whole map -----------------------------------------------------------------------------------------
    def clear_volume(self) -> None:
        """Empty the map for another pass; its blocks stay."""
        self._surface = None
        self.volume.reset()
        self.weight_sums.clear()

    def surface(self) -> TsdfSurface:
        """The surface of the map as it is now."""
        if self._surface is None:
            volume = self.volume
            self._surface = TsdfSurface(
                volume.grid, volume.sdf(), self.observed_mask(), volume.ray_far_m, volume.ray_step_m
            )
        return self._surface

    def observed_mask(self) -> Tensor:
        """(R,) bool: samples with enough observations."""
        return self.volume.counts() >= self.config.fusion.min_observations

    # --- checkpoint --------------------------------------------------------------------------------------------
    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from; without the noise models."""
        return {
            "blocks": self.volume.grid.blocks,
            "sums": self.volume.sums,
            "color_sums": self.volume.color_sums,
            "reliability": self.weights.reliability,
            "weight_sums": self.weight_sums.state_dict(),
            "log": self.log.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state of the same sensors and settings."""
        self._surface = None
        self.volume.grid.restore(state["blocks"].to(self.device))
        self.volume.sums = state["sums"].to(self.device)
        self.volume.color_sums = state["color_sums"].to(self.device)
        self.weights.reliability = dict(state["reliability"])
        self.weight_sums.load_state_dict(state["weight_sums"])
        self.log.load_state_dict(state["log"], self.device)


def pose_tensor(T_world_camera: np.ndarray | list[list[float]] | Tensor, device: torch.device | str) -> Tensor:
    """A pose (4, 4) as the map takes it: float32 on its device."""
    return torch.as_tensor(np.asarray(T_world_camera), dtype=torch.float32, device=device)
