"""The zero level of the fused distances, seen from any pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from .raycast import cast_rays
from .sparse_grid import SparseGrid


@dataclass(frozen=True)
class TsdfSurface:
    """The surface of a sampled signed distance.

    sdf (R,) metres and known (R,) bool of the samples of `grid`; rays end at the z-depth `far_m` and advance by
    `step_m`, metres.
    """

    grid: SparseGrid
    sdf: Tensor
    known: Tensor
    far_m: float
    step_m: float

    def raycast(self, origins: Tensor, directions: Tensor) -> Tensor:
        """(N,) z-depth at which rays (N, 3), (N, 3) of unit z-component meet the surface, metres; 0 = no surface."""
        return cast_rays(self.grid, self.sdf, self.known, origins, directions, self.far_m, self.step_m)

    def depth_along_rays(self, rays: Tensor, T_world_camera: Tensor) -> Tensor:
        """(N,) z-depth at which rays (N, 3) of a camera meet the surface, metres; 0 = no surface."""
        T = T_world_camera.to(self.sdf.device)
        directions = rays.to(self.sdf.device) @ T[:3, :3].T
        return self.raycast(T[:3, 3].expand(len(directions), 3), directions)

    def depth_from(self, camera: Camera, T_world_camera: np.ndarray, stride: int = 1) -> np.ndarray:
        """(h, w) z-depth, metres, of every `stride`-th pixel of the camera, 0 where there is no surface."""
        rays = camera.rays()[::stride, ::stride]
        hit = self.depth_along_rays(rays.reshape(-1, 3), torch.from_numpy(np.asarray(T_world_camera)).float())
        return hit.view(rays.shape[:2]).cpu().numpy()

    def median_depth(self, camera: Camera, T_world_camera: np.ndarray) -> float | None:
        """Median z-depth of the image, metres; None if no surface is in view."""
        depth = self.depth_from(camera, T_world_camera, stride=16)
        return float(np.median(depth[depth > 0])) if (depth > 0).any() else None
