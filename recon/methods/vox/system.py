"""The method as the shared loop runs it: `OnlineSystem`."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.config.map_config import MapConfig
from ...core.config.vox import VoxConfig
from ...core.events import OnEvent, track_progress
from ...core.frame import Frame
from ...run.frames import RunFrames
from ...volume.neural_field import NeuralField
from ..base import Poses
from ..online import Found
from .mapping import VoxMapper
from .model import VoxModel
from .surface import MAX_VIEWS, SampledSurface
from .tracking import track
from .views import VoxView, as_pose, pixel_directions


class VoxSystem:
    """Model, mapper and tracker. Measurements of all sensors have the same weight."""

    learns_uncertainty = False

    def __init__(self, frames: RunFrames, config: MapConfig, device: torch.device) -> None:
        self.frames, self.config, self.device = frames, config, device
        self.generator = torch.Generator(device).manual_seed(config.seed)  # of rays and offsets
        self.model = VoxModel(config.vox, device, torch.Generator().manual_seed(config.seed))
        self.directions = pixel_directions(frames.camera, device)
        self.mapper = VoxMapper(self.model, self.directions, self.generator)

    @property
    def settings(self) -> VoxConfig:
        """The settings of this method."""
        return self.config.vox

    @property
    def map_every(self) -> int:
        """Frames from one that is mapped to the next."""
        return self.settings.map_every

    def begin(self, indices: list[int], on_event: OnEvent) -> None:
        """Nothing is known beforehand."""

    def prepare(self, frame: Frame) -> VoxView:
        """The images, where the tensors live."""
        return VoxView.of(frame, self.settings, self.device)

    def track(self, frame: Frame, prepared: VoxView, recent: list[np.ndarray]) -> Found:
        """From where the last motion, repeated, would have brought the camera."""
        start = recent[-1] if len(recent) < 2 else recent[-1] @ np.linalg.inv(recent[-2]) @ recent[-1]
        if not len(prepared.usable):
            return Found(None, "lost")
        weight = self.settings.color_weight if self.config.tracking.color else 0.0
        settings = self.settings.model_copy(update={"color_weight": weight})
        pose, met = track(self.model, prepared.placed(start), self.directions, self.generator, settings)
        return Found(pose.double().cpu().numpy()) if met else Found(None, "lost")

    def map(self, frame: Frame, prepared: VoxView, T_world_camera: np.ndarray, last: bool) -> Poses:
        """The poses of earlier frames stay as they are."""
        self.mapper.map(prepared.placed(T_world_camera))
        return {}

    def betas(self, frame: Frame, prepared: VoxView) -> dict[str, Tensor]:
        """None: the method has no notion of error."""
        return {}

    def field(self, poses: Poses, on_event: OnEvent) -> NeuralField:
        """The model, sampled, where it exists and was seen by the measurements of frames spread over `poses`."""
        settings, order = self.settings, sorted(poses)
        surface = SampledSurface(self.model, self.frames.camera, self.config.fusion.voxel_size_m)
        chosen = np.unique(np.linspace(0, len(order) - 1, min(MAX_VIEWS, len(order))).round().astype(int))
        for position in track_progress(chosen, len(chosen), "finding what was seen", on_event, "views"):
            index = order[position]
            depths = torch.stack([self.frames.depth(index, s).view(-1) for s in self.frames.sensors], 1)
            depths = torch.where(depths < settings.max_depth_m, depths, 0.0)
            surface.count_view(depths.to(self.device), as_pose(poses[index]).to(self.device))
        return surface.field(settings.surface_readings, self.config.field, on_event)

    def curves(self) -> dict[str, list[float]]:
        """None: the loss is no likelihood."""
        return {}

    def keyframes(self) -> int:
        """Number of keyframes."""
        return len(self.mapper.keyframes)

    def artifacts(self) -> dict[str, Any]:
        """Voxels, corners, embeddings, decoder, and the mean loss of each mapped frame."""
        learned, settings = self.model.to_state(), self.settings
        return {**learned, "truncation_m": settings.truncation_m, "losses": list(self.mapper.losses)}

    def state_dict(self) -> dict[str, Any]:
        """Model, mapper and random generators, as plain tensors and containers."""
        return {
            "model": self.model.state_dict(),
            "mapper": self.mapper.state_dict(),
            "generators": [self.generator.get_state(), self.model.generator.get_state()],
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from what `state_dict` returned."""
        self.model.load_state_dict(state["model"])
        self.mapper.load_state_dict(state["mapper"])
        own, starts = state["generators"]
        self.generator.set_state(own.cpu())
        self.model.generator.set_state(starts.cpu())
