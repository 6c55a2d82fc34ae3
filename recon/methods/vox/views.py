"""Frames as the method keeps them, and the rays that are drawn from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.vox import VoxConfig
from ...core.frame import Frame
from .losses import Targets


@dataclass(frozen=True)
class VoxView:
    """colors (P, 3) uint8, depths (P, K) metres by sensor (0: not usable) of all pixels P; usable (U,) int64, pixels
    with any measurement; T_world_camera (4, 4)."""

    index: int
    colors: Tensor
    depths: Tensor
    usable: Tensor
    T_world_camera: Tensor

    @staticmethod
    def of(frame: Frame, config: VoxConfig, device: torch.device) -> VoxView:
        """Measurements out of range are dropped; the pose is that of the recording, if any."""
        depths = torch.stack([depth.reshape(-1) for depth in frame.depths.values()], 1)
        depths = torch.where((depths > config.min_depth_m) & (depths < config.max_depth_m), depths, 0.0)
        usable = (depths > 0).any(1).nonzero()[:, 0]
        pose = np.eye(4) if frame.T_world_camera is None else frame.T_world_camera
        view = VoxView(frame.index, frame.color.reshape(-1, 3), depths, usable, as_pose(pose))
        return view.to(device)

    def to(self, device: torch.device) -> VoxView:
        """The same view, its tensors on `device`."""
        return VoxView(self.index, *(part.to(device) for part in list(vars(self).values())[1:]))

    def placed(self, T_world_camera: Any) -> VoxView:
        """The same view from elsewhere."""
        return replace(self, T_world_camera=as_pose(T_world_camera).to(self.depths.device))

    def points(self, directions: Tensor) -> Tensor:
        """World points (M, 3) of all measurements; directions (P, 3) of the pixels in the camera."""
        pixel, sensor = self.depths.nonzero(as_tuple=True)
        points = directions[pixel] * self.depths[pixel, sensor, None]
        return points @ self.T_world_camera[:3, :3].T + self.T_world_camera[:3, 3]

    def targets(self, pixels: Tensor) -> Targets:
        """What was seen at pixels (..., N)."""
        depths = self.depths[pixels]
        return Targets(self.colors[pixels].float() / 255, depths, depths > 0)

    def draw(self, count: int, times: int, generator: torch.Generator) -> Tensor:
        """(times, count) usable pixels (fewer in a row, if there are fewer); those of a row are all different."""
        count = min(count, len(self.usable))
        rows, order = [], self.usable[:0]
        for _ in range(times if count else 0):
            if len(order) < count:
                order = self.usable[torch.randperm(len(self.usable), generator=generator, device=generator.device)]
            rows.append(order[:count])
            order = order[count:]
        return torch.stack(rows) if rows else self.usable[:0].view(0, 0)


def as_pose(matrix: Any) -> Tensor:
    """A (4, 4) matrix as float32."""
    return torch.as_tensor(np.asarray(matrix), dtype=torch.float32)


def pixel_directions(camera: Camera, device: torch.device) -> Tensor:
    """(P, 3) directions of all pixels in the camera, unit z."""
    return camera.rays(device).view(-1, 3)
