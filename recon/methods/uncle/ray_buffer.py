"""Pixels of the keyframes, kept for learning and refinement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.uncle import KeyframeConfig
from ...core.frame import Frame
from ...mvs.bias_model import BiasModel


@dataclass(frozen=True)
class Rays:
    """N pixels of keyframes.

    sensors: names of the S sensors, in the order of the columns below; frames (N,) int64 indices; origins, directions
    (N, 3) in world axes, a direction advances by 1 metre of z-depth; depths (N, S) metres, 0 = no measurement;
    colors (N, 3) uint8; inputs (N, S, F) float16 of the noise models, F = 0 if the uncertainty is off.
    """

    sensors: tuple[str, ...]
    frames: Tensor
    origins: Tensor
    directions: Tensor
    depths: Tensor
    colors: Tensor
    inputs: Tensor

    def __len__(self) -> int:
        return len(self.frames)

    def columns(self) -> dict[str, Tensor]:
        """All tensors by name."""
        return {field.name: getattr(self, field.name) for field in fields(self) if field.name != "sensors"}

    def at(self, rows: Tensor) -> Rays:
        """Some `rows` (B,)."""
        return Rays(self.sensors, **{name: values[rows] for name, values in self.columns().items()})

    def followed_by(self, other: Rays) -> Rays:
        """These rays and then those of `other`. Raises ValueError if the sensors differ."""
        if self.sensors != other.sensors:
            raise ValueError(f"rays of sensors {self.sensors} and {other.sensors}")
        first, second = self.columns(), other.columns()
        return Rays(self.sensors, **{name: torch.cat([first[name], second[name]]) for name in first})

    def measured_by(self, sensor: str) -> tuple[Tensor, Tensor]:
        """Depth (N,) metres, 0 = no measurement, and noise model inputs (N, F) float16 of one sensor."""
        column = self.sensors.index(sensor)
        return self.depths[:, column], self.inputs[:, column]

    def without_bias(self, models: Mapping[str, BiasModel]) -> Rays:
        """The rays with the active biases subtracted from their depths."""
        depths = self.depths.clone()
        for column, sensor in enumerate(self.sensors):
            if models[sensor].active:
                valid = depths[:, column] > 0
                depths[valid, column] -= models[sensor].offset(self.inputs[valid, column].float())
        return replace(self, depths=depths.clamp_(min=0))


class RayBuffer:
    """Random pixels of the keyframes, at most `config.max_rays` in all; `rays` is None before the first keyframe."""

    def __init__(
        self,
        camera: Camera,
        sensors: tuple[str, ...],
        config: KeyframeConfig,
        max_depth_m: float,
        device: torch.device | str = "cpu",
    ) -> None:
        self.camera, self.sensors, self.config = camera, sensors, config
        self.max_depth_m, self.device = max_depth_m, device
        self.rays: Rays | None = None

    def __len__(self) -> int:
        return 0 if self.rays is None else len(self.rays)

    def draw(
        self, frame: Frame, inputs: Mapping[str, Tensor], T_world_camera: Tensor, generator: torch.Generator
    ) -> Rays:
        """Random pixels of a frame that some sensor measured; none if there is none. `inputs` (H, W, F) by sensor."""
        depths = torch.stack([frame.depths[sensor].reshape(-1) for sensor in self.sensors], 1)
        usable = ((depths > 0) & (depths < self.max_depth_m)).any(1).nonzero()[:, 0]
        pixels = usable
        if len(usable):
            pixels = usable[torch.randint(len(usable), (self.config.rays,), generator=generator)]
        count, pose = len(pixels), T_world_camera.cpu()
        stacked = torch.zeros(count, len(self.sensors), 0)
        if inputs:
            images = [inputs[sensor] for sensor in self.sensors]
            stacked = torch.stack([image.view(-1, image.shape[-1])[pixels] for image in images], 1).half()
        rays = Rays(
            self.sensors,
            frames=torch.full((count,), frame.index),
            origins=pose[:3, 3].repeat(count, 1),  # memory of its own: rays can move
            directions=self.camera.rays().view(-1, 3)[pixels] @ pose[:3, :3].T,
            depths=depths[pixels],
            colors=frame.color.view(-1, 3)[pixels],
            inputs=stacked,
        )
        return Rays(self.sensors, **{name: values.to(self.device) for name, values in rays.columns().items()})

    def add(self, rays: Rays, generator: torch.Generator) -> None:
        """Append; beyond the capacity random rays are dropped, so that all keyframes stay represented."""
        if self.rays is not None:
            rays = self.rays.followed_by(rays)
        if len(rays) > self.config.max_rays:
            kept = torch.randperm(len(rays), generator=generator)[: self.config.max_rays].sort().values
            rays = rays.at(kept)
        self.rays = rays

    def move(self, motions: Mapping[int, Tensor]) -> None:
        """Move the rays of frames with their cameras: frame index -> T_new_old (4, 4) in world axes."""
        if self.rays is None or not motions:
            return
        origins, directions = self.rays.origins.clone(), self.rays.directions.clone()  # rows may share memory
        for index, T_new_old in motions.items():
            rows = (self.rays.frames == index).nonzero()[:, 0]
            motion = T_new_old.to(origins)
            origins[rows] = origins[rows] @ motion[:3, :3].T + motion[:3, 3]
            directions[rows] = directions[rows] @ motion[:3, :3].T
        self.rays = replace(self.rays, origins=origins, directions=directions)

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {"rays": None if self.rays is None else self.rays.columns()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state of the same sensors and settings."""
        columns = state["rays"]
        self.rays = None
        if columns is not None:
            self.rays = Rays(self.sensors, **{name: values.to(self.device) for name, values in columns.items()})
