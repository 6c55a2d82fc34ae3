"""Which frames a mapped frame is optimised with (METHOD, Mapping: frame window)."""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.camera import Camera

PIXELS, SAMPLES = 100, 16  # of the overlap test
BEFORE, BEHIND_M = 0.8, 0.5  # samples lie from this share of the depth to so far behind it
MARGIN = 20  # pixels at the border of a keyframe that see nothing


def mean_depth(depths: Tensor) -> Tensor:
    """(K, ...) metres -> (...) mean of the sensors that read something, 0 where none does."""
    return depths.sum(0) / (depths > 0).sum(0).clamp(min=1)


def overlapping(
    depths: Tensor, T_world_camera: Tensor, keyframes: Tensor, camera: Camera, generator: torch.Generator
) -> list[int]:
    """Keyframes (M, 4, 4) T_world_camera that see any of what a frame with depths (K, H, W) sees, in random order."""
    if not len(keyframes):
        return []
    height, width = depths.shape[-2:]
    picks = torch.randint(height * width, (PIXELS,), generator=generator).to(depths.device)
    depth = mean_depth(depths.reshape(len(depths), -1)[:, picks])
    x, y = (picks % width - camera.cx) / camera.fx, (picks // width - camera.cy) / camera.fy
    directions = torch.stack([x, y, torch.ones_like(x)], -1)[depth > 0]
    depth = depth[depth > 0]
    steps = torch.linspace(0.0, 1.0, SAMPLES, device=depths.device)
    z = BEFORE * depth[:, None] * (1 - steps) + (depth[:, None] + BEHIND_M) * steps
    points = (directions[:, None] * z[..., None]).view(-1, 3) @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    local = torch.einsum("mij,mnj->mni", keyframes[:, :3, :3].transpose(1, 2), points - keyframes[:, None, :3, 3])
    u, v, front = camera.project(local)
    inside = (u > MARGIN) & (u < camera.width - MARGIN) & (v > MARGIN) & (v < camera.height - MARGIN) & (front > 0)
    seen = inside.any(1).nonzero()[:, 0].tolist()
    return [seen[i] for i in torch.randperm(len(seen), generator=generator).tolist()]


def choose_window(overlapping: list[int], keyframes: int, size: int) -> list[int]:
    """Keyframes that join the current frame: up to size - 2 of those that overlap, and the newest."""
    if not keyframes:
        return []
    newest = keyframes - 1
    return [*[k for k in overlapping if k != newest][: size - 2], newest]
