"""Which features a frame may change (METHOD, Mapping: frustum feature selection)."""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.camera import Camera

BEHIND_M = 0.5  # vertices so far behind a reading are still optimised,
AROUND_M = 0.5  # and so are those this close to the camera


def in_frustum(vertices: Tensor, depths: Tensor, T_world_camera: Tensor, camera: Camera) -> Tensor:
    """vertices (V, 3) world, metres; depths (K, H, W) metres; pose (4, 4) -> (V,) bool: seen by any of K sensors."""
    local = (vertices - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
    u, v, z = camera.project(local)
    inside = (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1) & (z > 0)
    scale = torch.tensor([2 / (camera.width - 1), 2 / (camera.height - 1)], device=u.device)
    places = torch.stack([u, v], -1).clamp(-1e4, 1e4) * scale - 1
    found = torch.nn.functional.grid_sample(
        depths[None], places[None, None], mode="bilinear", padding_mode="zeros", align_corners=True
    )[0, :, 0]
    farthest = depths.flatten(1).amax(1)[:, None]
    reach = torch.where(found > 0, found, farthest)
    seen = inside & (z <= reach + BEHIND_M).any(0)
    return seen | (local.norm(dim=-1) < AROUND_M)
