"""Weighted fusion of depth images into signed distances: the closed-form part of the map.

Each sample keeps running sums over all readings that saw it: weights, weighted distance, weighted squared distance and
weighted colour. Where every weight is 1 this is plain truncated-distance fusion; with the weights 1/beta^2 of the
learned uncertainty it is the maximum-likelihood mean under that noise.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from .camera import Camera
from .grid import BLOCK, ROWS, SparseGrid


class FusionVolume:
    """Running sums on a sparse grid. `truncation_m` bounds the distances."""

    def __init__(self, grid: SparseGrid, truncation_m: float) -> None:
        self.grid = grid
        self.truncation_m = float(truncation_m)
        self.sums = torch.zeros(0, 3, device=grid.device)  # (R, 3): weight, weight * sdf, weight * sdf^2
        self.color_sums = torch.zeros(0, 4, device=grid.device)  # (R, 4): weight, weight * rgb

    def allocate(self, depth: Tensor, camera: Camera, T_world_camera: Tensor, max_depth_m: float) -> None:
        """Make blocks for the band of +- truncation around each reading of `depth` (H, W) metres."""
        stride = max(1, int(0.5 * self.grid.block_size_m * camera.fx / max_depth_m))
        rays = camera.rays(self.grid.device)[::stride, ::stride]
        z = depth[::stride, ::stride]
        valid = (z > 0) & (z < max_depth_m)
        directions, z = rays[valid], z[valid]
        if len(z) == 0:
            return
        rotation, origin = T_world_camera[:3, :3], T_world_camera[:3, 3]
        found = []
        for offset in torch.linspace(-1, 1, 5).tolist():
            points = (directions * (z + offset * self.truncation_m)[:, None]) @ rotation.T + origin
            found.append(torch.floor(points / self.grid.block_size_m).long())
        self.grid.allocate(torch.cat(found))

    def grow(self) -> None:
        """Give every block of the grid its rows of zeros."""
        missing = self.grid.rows - len(self.sums)
        if missing > 0:
            self.sums = torch.cat([self.sums, self.sums.new_zeros(missing, 3)])
            self.color_sums = torch.cat([self.color_sums, self.color_sums.new_zeros(missing, 4)])

    def integrate(self, depth, weight, color, camera: Camera, T_world_camera: Tensor, max_depth_m: float) -> None:
        """Add one depth image: depth (H, W) metres, weight (H, W) or None = 1, color (H, W, 3) uint8 or None."""
        T_camera_world = torch.linalg.inv(T_world_camera.double()).float()
        ids = self._visible(depth, camera, T_camera_world, max_depth_m)
        for chunk in ids.split(2048):
            self._integrate_blocks(chunk, depth, weight, color, camera, T_camera_world, max_depth_m)

    def _visible(self, depth, camera, T_camera_world, max_depth_m):
        """Ids of blocks that are in the image and not wholly behind what it shows."""
        half = 0.5 * (BLOCK - 1) * self.grid.voxel_size_m
        centres = self.grid.blocks.float() * self.grid.block_size_m + half
        points = centres @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
        radius = half * 3**0.5
        u, v, z = camera.project(points)
        reach = radius * max(camera.fx, camera.fy) / z.clamp(min=0.05)
        inside = (u > -reach) & (u < camera.width + reach) & (v > -reach) & (v < camera.height + reach)
        inside &= (z > -radius) & (z < max_depth_m + radius)
        tile = 16
        usable = torch.where(depth < max_depth_m, depth, 0)
        far = max_pool2d(usable[None, None], tile, tile, ceil_mode=True)
        far = max_pool2d(far, 5, 1, 2)[0, 0]  # farthest reading within about two tiles
        tu = (u / tile).long().clamp(0, far.shape[1] - 1)
        tv = (v / tile).long().clamp(0, far.shape[0] - 1)
        close = z < 1.0  # such a block may cover more than the tiles looked at
        inside &= close | (z - radius < far[tv, tu] + self.truncation_m)
        return inside.nonzero()[:, 0]

    def _integrate_blocks(self, ids, depth, weight, color, camera, T_camera_world, max_depth_m):
        rotation, shift = T_camera_world[:3, :3], T_camera_world[:3, 3]
        steps = torch.arange(BLOCK, device=self.grid.device) * self.grid.voxel_size_m
        inner = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).view(ROWS, 3) @ rotation.T
        outer = (self.grid.blocks[ids].float() * self.grid.block_size_m) @ rotation.T + shift
        z = outer[:, 2:3] + inner[:, 2]
        inverse = 1 / z.clamp(min=1e-3)
        u = ((outer[:, 0:1] + inner[:, 0]) * inverse * camera.fx + (camera.cx + 0.5)).floor_()
        v = ((outer[:, 1:2] + inner[:, 1]) * inverse * camera.fy + (camera.cy + 0.5)).floor_()
        seen = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & (z > 0.05)
        picked = seen.view(-1).nonzero()[:, 0]
        z = z.view(-1)[picked]
        pixel = (v.view(-1)[picked] * camera.width + u.view(-1)[picked]).long()
        reading = depth.view(-1)[pixel]
        sdf = reading - z
        keep = (reading > 0) & (reading < max_depth_m) & (sdf > -self.truncation_m)
        picked, pixel, sdf = picked[keep], pixel[keep], sdf[keep].clamp(max=self.truncation_m)
        rows = ids[picked // ROWS] * ROWS + picked % ROWS
        w = torch.ones_like(sdf) if weight is None else weight.view(-1)[pixel]
        ws = w * sdf
        self.sums[rows] += torch.stack([w, ws, ws * sdf], -1)
        if color is not None:
            near = sdf.abs() < self.truncation_m * 0.999
            w, rows, pixel = w[near], rows[near], pixel[near]
            self.color_sums[rows] += torch.cat([w[:, None], w[:, None] * color.view(-1, 3)[pixel].float()], -1)

    def sdf(self) -> tuple[Tensor, Tensor]:
        """(R,) signed distances in metres (0 where unseen) and (R,) weights."""
        weight = self.sums[:, 0]
        return self.sums[:, 1] / weight.clamp(min=1e-12), weight
