"""The keyframes that a frame is mapped together with (docs/uncle-paper.md, Mapping)."""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.camera import Camera

# Constants of the overlap test in the released code of NICE-SLAM and UncLe-SLAM.
PIXELS, SAMPLES = 100, 16
BEFORE_RATIO, BEHIND_M = 0.8, 0.5  # samples lie from this ratio of the depth to so far behind it
MARGIN_PX = 20  # pixels at the border of a keyframe that do not count


def mean_depth(depths: Tensor) -> Tensor:
    """(K, ...) metres -> (...) mean of the sensors with a depth, 0 where none has one."""
    return depths.sum(0) / (depths > 0).sum(0).clamp(min=1)


def overlapping_keyframes(
    depths: Tensor, T_world_camera: Tensor, keyframes: Tensor, camera: Camera, generator: torch.Generator
) -> list[int]:
    """Keyframes (M, 4, 4) T_world_camera that see any of what a frame with depths (K, H, W) sees, in random order."""
    if not len(keyframes):
        return []
    height, width = depths.shape[-2:]
    picks = torch.randint(height * width, (PIXELS,), generator=generator).to(depths.device)
    depth = mean_depth(depths.reshape(len(depths), -1)[:, picks])
    x, y = camera.unproject(picks % width, picks // width)
    directions = torch.stack([x, y, torch.ones_like(x)], -1)[depth > 0]
    depth = depth[depth > 0]
    steps = torch.linspace(0.0, 1.0, SAMPLES, device=depths.device)
    z = BEFORE_RATIO * depth[:, None] * (1 - steps) + (depth[:, None] + BEHIND_M) * steps
    points = (directions[:, None] * z[..., None]).view(-1, 3) @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
    local = torch.einsum("mij,mnj->mni", keyframes[:, :3, :3].transpose(1, 2), points - keyframes[:, None, :3, 3])
    u, v, front = camera.project(local)
    inside_u = (u > MARGIN_PX) & (u < camera.width - MARGIN_PX)
    inside_v = (v > MARGIN_PX) & (v < camera.height - MARGIN_PX)
    overlaps = (inside_u & inside_v & (front > 0)).any(1).nonzero()[:, 0].tolist()
    return [overlaps[i] for i in torch.randperm(len(overlaps), generator=generator).tolist()]


def choose_window(overlapping: list[int], keyframes: int, size: int) -> list[int]:
    """Keyframes that join the current frame: up to size - 2 of the overlapping ones, and the newest."""
    if not keyframes:
        return []
    newest = keyframes - 1
    return [*[k for k in overlapping if k != newest][: size - 2], newest]
