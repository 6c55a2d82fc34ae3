"""Which voxels exist, and the embeddings' rows at their corners."""

from __future__ import annotations

import torch
from torch import Tensor

from ...volume.sparse_grid import BLOCK, CORNERS, SparseGrid


class VoxelMap:
    """Sparse cubes made from depth points; neighbours share the corners between them.

    Voxel (i, j, k) covers size_m * [i, i + 1) and so on. `voxels` and `corners` are indices over integer coordinates:
    block (i, j, k) of the first is a voxel, of the second a corner, its id the row of the corner's embedding.
    """

    def __init__(self, size_m: float, device: torch.device | str = "cpu") -> None:
        self.size_m = float(size_m)
        self.voxels, self.corners = SparseGrid(size_m / BLOCK, device), SparseGrid(size_m / BLOCK, device)
        self.corner_rows = torch.empty(0, 8, dtype=torch.int64, device=device)  # by voxel, in the order of CORNERS

    def __len__(self) -> int:
        return len(self.voxels.blocks)

    def add_points(self, points: Tensor) -> int:
        """Make the voxels around world points (N, 3), metres; returns how many were new."""
        new = self.voxels.allocate(torch.floor(points / self.size_m).long())
        if new:
            around = self.voxels.blocks[-new:, None, :] + CORNERS.to(self.voxels.device)
            self.corners.allocate(around.view(-1, 3))
            self.corner_rows = torch.cat([self.corner_rows, self.corners.block_ids(around)])
        return new

    def restore(self, voxels: Tensor, corners: Tensor) -> None:
        """Become the map with exactly these voxels (V, 3) and corners (C, 3), in this order."""
        self.voxels.restore(voxels)
        self.corners.restore(corners)
        around = voxels[:, None, :] + CORNERS.to(voxels.device)
        self.corner_rows = self.corners.block_ids(around) if len(voxels) else self.corner_rows[:0]

    def fractions(self, points: Tensor, ids: Tensor) -> Tensor:
        """(N, 3) world points in the voxels `ids` (N,) -> (N, 3) place within the voxel, 0..1; differentiable."""
        return points / self.size_m - self.voxels.blocks[ids].to(points.dtype)

    def containing(self, points: Tensor, slack_m: float = 1e-4) -> Tensor:
        """(N, 3) -> (N,) id of a voxel that holds the point, its faces included; -1 = none."""
        found = self.voxels.block_ids(torch.floor(points / self.size_m).long())
        for corner in CORNERS.to(points):
            shifted = points + (2 * corner - 1) * slack_m
            beside = self.voxels.block_ids(torch.floor(shifted / self.size_m).long())
            found = torch.where(found >= 0, found, beside)
        return found
