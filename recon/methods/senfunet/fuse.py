"""Fusion of one or two sensors as SenFuNet does it: a map of each, and a learned share of the first in every sample."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...core.config.map_config import MapConfig
from ...core.events import OnEvent, Progress, Warn, ignore, track_progress
from ...core.frame import Frame
from ...run.frames import RunFrames
from ...volume.neural_field import NeuralField
from ...volume.sparse_grid import SparseGrid, unique_blocks
from .blending import believed, fused_distance, weighting_inputs
from .bricks import brick_samples, inner_part
from .models import SenfunetModel
from .sensor_grid import RaySamples, SensorGrid, ray_samples

_BRICKS_AT_A_TIME = 16
_COLOR_VOXELS = 1.5  # a measurement paints the samples this close to it


def fuse_senfunet(
    frames: RunFrames,
    indices: list[int],
    config: MapConfig,
    model: SenfunetModel | None,
    device: torch.device,
    on_event: OnEvent = ignore,
    tracked: dict[int, np.ndarray] | None = None,
) -> tuple[NeuralField, dict[int, np.ndarray]]:
    """Fuse the sensors of `frames`; returns the map and T_world_camera by frame index.

    The poses are those `tracked`, by frame index, else those of the recording. `model` is of the two sensors; None
    where there is only one, which is then fused alone.
    """
    if model is not None:
        _compare_voxels(model.voxel_size_m, config.fusion.voxel_size_m, on_event)
    volume = SenfunetVolume(frames, config, model, device)
    poses = {}
    for done, frame in enumerate(frames.stream(indices, lambda frame: frame)):
        on_event(Progress("fusing", done, len(indices)))
        T_world_camera = frame.T_world_camera if tracked is None else tracked.get(frame.index)
        if T_world_camera is not None:
            poses[frame.index] = T_world_camera
            volume.add(frame, torch.from_numpy(np.asarray(T_world_camera)).float().to(device))
    on_event(Progress("fusing", len(indices), len(indices)))
    return volume.field(config, on_event), poses


def _compare_voxels(trained_m: float, wanted_m: float, on_event: OnEvent) -> None:
    if not 0.5 < wanted_m / trained_m < 2:
        text = f"the networks of senfunet were trained on voxels of {trained_m * 100:g} cm, not {wanted_m * 100:g} cm"
        on_event(Warn(f"{text}: `uncle pretrain senfunet --voxel {wanted_m:g}` makes better ones"))


class SenfunetVolume:
    """The maps of the sensors over one sparse grid, and the colours of both."""

    def __init__(self, frames: RunFrames, config: MapConfig, model: SenfunetModel | None, device: torch.device) -> None:
        self.sensors = model.sensors if model else frames.sensors
        self.model, self.device = model.to(device) if model else None, device
        self.grid = SparseGrid(config.fusion.voxel_size_m, device)
        self.maps = {sensor: SensorGrid(0, device) for sensor in self.sensors}
        self.colors = torch.zeros(0, 4, device=device)  # sums of rgb 0..1, and their number
        self.before, self.reach = round(config.fusion.truncation_voxels), config.fusion.max_depth_m
        self._rays = frames.camera.rays(device)

    @torch.no_grad()
    def add(self, frame: Frame, T_world_camera: Tensor) -> None:
        """Take in all measurements of a frame."""
        color = frame.color.to(self.device).float() / 255
        for sensor in self.sensors:
            depth = frame.depths[sensor].to(self.device)
            samples = ray_samples(depth, self._rays, T_world_camera, self.grid.voxel_size_m, self.before, self.reach)
            if not len(samples.pixels):
                continue
            rows = self._rows(samples.voxels)
            features = self._features(sensor, depth, color)[samples.pixels]
            self.maps[sensor].apply(self.maps[sensor].with_measurements(rows, samples.sdf, features))
            self._paint(rows, samples, color)

    def field(self, config: MapConfig, on_event: OnEvent = ignore) -> NeuralField:
        """The fused map. Where one sensor read something its distance counts alone, if the network believes it."""
        rows = self.grid.rows
        first = self.maps[self.sensors[0]]
        sdf, weight, kept = (
            first.tsdf[:rows],
            first.weight[:rows],
            torch.ones(rows, dtype=torch.bool, device=self.device),
        )
        if self.model is not None:
            second = self.maps[self.sensors[1]]
            alpha = self._alpha(on_event)
            sdf = fused_distance(alpha, sdf, second.tsdf[:rows], weight, second.weight[:rows])
            if config.senfunet.outlier_filter:
                kept = believed(alpha, weight, second.weight[:rows])
            else:
                kept = weight + second.weight[:rows] > 0
            weight = weight + second.weight[:rows]
        known = kept & (weight >= config.fusion.min_observations)
        count = self.colors[:rows, 3:]
        rgb = torch.where(count > 0, self.colors[:rows, :3] / count.clamp(min=1), 0.5)
        sigma = torch.full_like(sdf, self.before * self.grid.voxel_size_m)  # it says nothing about its own error
        plain = config.field.model_copy(update={"levels": ()})
        base = torch.cat([torch.where(known, sdf, 0.0)[:, None], rgb], 1)
        return NeuralField(self.grid, base, sigma, known, plain, torch.Generator())

    def _rows(self, voxels: Tensor) -> Tensor:
        """Rows of samples (M, K, 3), made where they are missing."""
        rows = self.grid.sample_rows(voxels)
        missing = voxels[rows < 0]
        if not len(missing):
            return rows
        self.grid.allocate(missing >> 3)
        for sensor_map in self.maps.values():
            sensor_map.grow(self.grid.rows)
        if len(self.colors) < self.grid.rows:
            spare = self.grid.rows + self.grid.rows // 2 - len(self.colors)
            self.colors = torch.cat([self.colors, self.colors.new_zeros(spare, 4)])
        return self.grid.sample_rows(voxels)

    def _features(self, sensor: str, depth: Tensor, color: Tensor) -> Tensor:
        """(H * W, 4); zeros where nothing is learned."""
        if self.model is None:
            return torch.zeros(depth.numel(), 4, device=self.device)
        features = self.model.features[sensor](depth[None, None], color.permute(2, 0, 1)[None])
        return features[0].permute(1, 2, 0).reshape(-1, features.shape[1])

    def _paint(self, rows: Tensor, samples: RaySamples, color: Tensor) -> None:
        near = samples.sdf.abs() < _COLOR_VOXELS * self.grid.voxel_size_m
        rgb = color.view(-1, 3)[samples.pixels]
        rgb = torch.cat([rgb, torch.ones_like(rgb[:, :1])], 1)
        for column in near.nonzero()[:, 0].tolist():
            self.colors.index_add_(0, rows[:, column], rgb)

    @torch.no_grad()
    def _alpha(self, on_event: OnEvent) -> Tensor:
        """(R,) share of the first sensor."""
        assert self.model is not None
        maps = [self.maps[sensor] for sensor in self.sensors]
        alpha = torch.zeros(self.grid.rows, device=self.device)
        parts = unique_blocks(self.grid.blocks >> 1).split(_BRICKS_AT_A_TIME)
        for bricks in track_progress(parts, len(parts), "weighing the sensors", on_event, "parts"):
            rows = self.grid.sample_rows(brick_samples(bricks))
            at, there = rows.clamp(min=0), rows >= 0
            features = (maps[0].features[at] * there[..., None], maps[1].features[at] * there[..., None])
            weights = (maps[0].weight[at] * there, maps[1].weight[at] * there)
            inner = inner_part(rows)
            shares = self.model.weighting(weighting_inputs(features, weights))
            alpha[inner[inner >= 0]] = shares[inner >= 0]
        return alpha
