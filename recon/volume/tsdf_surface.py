"""The surface of the map as seen from anywhere."""

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
    """Distances sdf (R,) metres of the samples of a grid and which are known (R,); how far rays go, and their steps."""

    grid: SparseGrid
    sdf: Tensor
    known: Tensor
    far_m: float
    step_m: float

    def cast(self, origins: Tensor, directions: Tensor) -> Tensor:
        """(N,) z-depth at which rays (N, 3), (N, 3) of unit z-component meet the surface, metres; 0 = they do not."""
        return cast_rays(self.grid, self.sdf, self.known, origins, directions, self.far_m, self.step_m)

    def along(self, rays: Tensor, T_world_camera: Tensor) -> Tensor:
        """(N,) z-depth at which rays (N, 3) of a camera meet the surface, metres; 0 = they do not."""
        T = T_world_camera.to(self.sdf.device)
        directions = rays.to(self.sdf.device) @ T[:3, :3].T
        return self.cast(T[:3, 3].expand(len(directions), 3), directions)

    def depth_from(self, camera: Camera, T_world_camera: np.ndarray, stride: int = 1) -> np.ndarray:
        """(h, w) metres as seen by every `stride`-th pixel of the camera, 0 where nothing is hit."""
        rays = camera.rays()[::stride, ::stride]
        hit = self.along(rays.reshape(-1, 3), torch.from_numpy(np.asarray(T_world_camera)).float())
        return hit.view(rays.shape[:2]).cpu().numpy()

    def median_depth(self, camera: Camera, T_world_camera: np.ndarray) -> float | None:
        """Median depth from there, metres; None where nothing is seen."""
        depth = self.depth_from(camera, T_world_camera, stride=16)
        return float(np.median(depth[depth > 0])) if (depth > 0).any() else None
