"""Selection of the frames whose pixels are kept for learning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.uncle import KeyframeConfig
from ...core.frame import Frame


@dataclass(frozen=True)
class KeyframeParameters:
    """Overlap test: `probes` points of a frame are projected into earlier keyframes. A point counts as seen if the
    ratio of its depths in the two views lies between the limits: from a very different distance it is another
    observation."""

    probes: int = 400
    min_depth_ratio: float = 0.67
    max_depth_ratio: float = 1.5


class KeyframeSelector:
    """A frame becomes a keyframe when no earlier keyframe sees enough of it.

    The number of keyframes follows the extent of the scene: a camera that stays or returns adds almost none.
    """

    def __init__(
        self, camera: Camera, config: KeyframeConfig, parameters: KeyframeParameters = KeyframeParameters()
    ) -> None:
        self.camera, self.config, self.parameters = camera, config, parameters
        self.T_camera_world: list[Tensor] = []

    def __len__(self) -> int:
        return len(self.T_camera_world)

    def is_keyframe(self, frame: Frame, T_world_camera: Tensor) -> bool:
        """Decide on one frame, and remember its pose if it becomes a keyframe."""
        T_world_camera = T_world_camera.cpu()  # as frames are on the CPU
        chosen = not self.T_camera_world or self._overlap(frame, T_world_camera) < self.config.max_overlap
        if chosen:
            self.T_camera_world.append(torch.linalg.inv(T_world_camera.double()).float())
        return chosen

    def _overlap(self, frame: Frame, T_world_camera: Tensor) -> float:
        """Largest fraction of the frame's measurements that lie within the view of one earlier keyframe."""
        depth = mean_depth(frame)
        pixels = (depth.view(-1) > 0).nonzero()[:, 0]
        if len(pixels) == 0:
            return 1.0
        pixels = pixels[torch.linspace(0, len(pixels) - 1, self.parameters.probes).long()]
        z = depth.view(-1)[pixels]
        points = self.camera.rays().view(-1, 3)[pixels] * z[:, None]
        points = points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        views = torch.stack(self.T_camera_world)
        local = points @ views[:, :3, :3].transpose(1, 2) + views[:, None, :3, 3]
        u, v, z_keyframe = self.camera.project(local)
        inside = (u >= 0) & (u < self.camera.width) & (v >= 0) & (v < self.camera.height)
        ratio = z_keyframe / z
        similar = (ratio < self.parameters.max_depth_ratio) & (ratio > self.parameters.min_depth_ratio)
        return float((inside & similar).float().mean(1).max())

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {"T_camera_world": self.T_camera_world}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state with the same settings."""
        self.T_camera_world = list(state["T_camera_world"])


def mean_depth(frame: Frame) -> Tensor:
    """(H, W) mean over the sensors that measured a pixel, metres; 0 where none did."""
    stack = torch.stack(list(frame.depths.values()))
    return stack.sum(0) / (stack > 0).sum(0).clamp(min=1)
