"""Which frames lend their pixels to the learning, and those pixels."""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.uncle import KeyframeConfig
from ...core.frame import Frame

_PROBES = 400  # points of a frame that are looked for in earlier keyframes


class KeyframeSelector:
    """A frame becomes a keyframe when no earlier keyframe sees enough of it.

    Their number follows the extent of what was seen: a camera that stays, or comes back, adds (almost) none.
    """

    def __init__(self, camera: Camera, config: KeyframeConfig) -> None:
        self.camera, self.config = camera, config
        self.T_camera_world: list[Tensor] = []

    def is_keyframe(self, frame: Frame, T_world_camera: Tensor) -> bool:
        """Decide about one frame and remember it if it is one."""
        T_world_camera = T_world_camera.cpu()  # frames are there, too
        chosen = not self.T_camera_world or self._overlap(frame, T_world_camera) < self.config.max_overlap
        if chosen:
            self.T_camera_world.append(torch.linalg.inv(T_world_camera.double()).float())
        return chosen

    def _overlap(self, frame: Frame, T_world_camera: Tensor) -> float:
        """Largest share of the frame's readings that lies inside the view of one earlier keyframe."""
        depth = mean_depth(frame)
        pixels = (depth.view(-1) > 0).nonzero()[:, 0]
        if len(pixels) == 0:
            return 1.0
        pixels = pixels[torch.linspace(0, len(pixels) - 1, _PROBES).long()]
        z = depth.view(-1)[pixels]
        points = self.camera.rays().view(-1, 3)[pixels] * z[:, None]
        points = points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        views = torch.stack(self.T_camera_world)
        seen = points @ views[:, :3, :3].transpose(1, 2) + views[:, None, :3, 3]
        u, v, z_there = self.camera.project(seen)
        inside = (u >= 0) & (u < self.camera.width) & (v >= 0) & (v < self.camera.height)
        near = (z_there / z < 1.5) & (z_there / z > 0.67)  # from a much other distance it is not the same observation
        return float((inside & near).float().mean(1).max())


def mean_depth(frame: Frame) -> Tensor:
    """(H, W) mean over the sensors that have a reading there, metres; 0 where none has (METHOD.md section 6)."""
    stack = torch.stack(list(frame.depths.values()))
    return stack.sum(0) / (stack > 0).sum(0).clamp(min=1)
