"""The features that a frame may change (docs/uncle-paper.md, Mapping, visible features)."""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.camera import Camera

# Constants of the released code of NICE-SLAM and UncLe-SLAM.
BEHIND_M = 0.5  # vertices so far behind a depth are still optimised,
AROUND_M = 0.5  # and so are those this close to the camera


def in_frustum(vertices: Tensor, depths: Tensor, T_world_camera: Tensor, camera: Camera) -> Tensor:
    """Whether any of K sensors sees a vertex, (V,) bool.

    vertices (V, 3) world, metres; depths (K, H, W) metres, 0 = none, where the image's largest depth counts.
    """
    local = (vertices - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    u, v, z = camera.project(local)
    inside = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1) & (z > 0)
    scale = torch.tensor([2 / (camera.width - 1), 2 / (camera.height - 1)], device=u.device)
    places = torch.stack([u, v], -1).clamp(-1e4, 1e4) * scale - 1
    measured = torch.nn.functional.grid_sample(
        depths[None], places[None, None], mode="bilinear", padding_mode="zeros", align_corners=True
    )[0, :, 0]
    farthest = depths.flatten(1).amax(1)[:, None]
    limit = torch.where(measured > 0, measured, farthest)
    visible = inside & (z <= limit + BEHIND_M).any(0)
    return visible | (local.norm(dim=-1) < AROUND_M)
