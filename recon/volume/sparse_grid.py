"""A sparse voxel grid: blocks of 8 x 8 x 8 samples, allocated only where there is a surface.

Samples lie at integer multiples of the voxel size (sample (i, j, k) at world position voxel_size * (i, j, k)). Values
are kept in flat tables with one row per sample; row = block_id * ROWS + (x * BLOCK + y) * BLOCK + z inside the block.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..core.compiled import compiled

BLOCK_BITS = 3
BLOCK = 1 << BLOCK_BITS  # samples on a side: a power of two, so that compiled loops find blocks by shifts
ROWS = BLOCK**3
_LAST = BLOCK - 1
Index = int | np.int64
_MARGIN = 8  # blocks of slack when the lookup volume grows, so that it does not grow with every frame


class SparseGrid:
    """The allocated blocks and the rows of their samples. Memory: 4 bytes per block of the bounding box."""

    def __init__(self, voxel_size_m: float, device: torch.device | str = "cpu") -> None:
        self.voxel_size_m = float(voxel_size_m)
        self.device = torch.device(device)
        self.blocks = torch.empty(0, 3, dtype=torch.int64, device=self.device)  # (B, 3) block coordinates
        self._origin = torch.zeros(3, dtype=torch.int64, device=self.device)
        self._volume = torch.full((1, 1, 1), -1, dtype=torch.int32, device=self.device)
        self._shape = torch.ones(3, dtype=torch.int64, device=self.device)  # of the volume; no lookup waits for it

    @property
    def rows(self) -> int:
        """Number of samples."""
        return len(self.blocks) * ROWS

    @property
    def block_size_m(self) -> float:
        """Side of a block, metres."""
        return BLOCK * self.voxel_size_m

    def allocate(self, blocks: Tensor) -> int:
        """Add those of `blocks` (M, 3) int64 that do not exist yet; returns how many were new. Existing rows stay."""
        if len(blocks) == 0:
            return 0
        blocks = unique_blocks(blocks)
        new = blocks[self.block_ids(blocks) < 0]
        if len(new):
            self._cover(new)
            ids = torch.arange(len(self.blocks), len(self.blocks) + len(new), dtype=torch.int32, device=self.device)
            x, y, z = (new - self._origin).unbind(-1)
            self._volume[x, y, z] = ids
            self.blocks = torch.cat([self.blocks, new])
        return len(new)

    def restore(self, blocks: Tensor) -> None:
        """Become the grid with exactly these blocks (B, 3), in this order."""
        self.blocks = torch.empty(0, 3, dtype=torch.int64, device=self.device)
        self._origin, self._volume = torch.zeros_like(self._origin), self._volume.new_full((1, 1, 1), -1)
        self._shape = torch.ones_like(self._shape)
        if len(blocks):
            self._cover(blocks)
            x, y, z = (blocks - self._origin).unbind(-1)
            self._volume[x, y, z] = torch.arange(len(blocks), dtype=torch.int32, device=self.device)
        self.blocks = blocks

    def block_ids(self, blocks: Tensor) -> Tensor:
        """(..., 3) int64 block coordinates -> (...) int64 ids, -1 where there is no block."""
        shape = self._shape
        local = blocks - self._origin
        inside = ((local >= 0) & (local < shape)).all(-1)
        local = torch.where(inside[..., None], local, 0)
        flat = (local[..., 0] * shape[1] + local[..., 1]) * shape[2] + local[..., 2]
        ids = self._volume.view(-1)[flat].long()
        return torch.where(inside, ids, -1)

    def sample_rows(self, samples: Tensor) -> Tensor:
        """(..., 3) int64 sample coordinates -> (...) int64 rows, -1 where there is no block."""
        if samples.device.type == "cpu":
            rows = _rows_of(samples.reshape(-1, 3).numpy(), *self.lookup())
            return torch.from_numpy(rows).view(samples.shape[:-1])
        ids = self.block_ids(samples >> BLOCK_BITS)
        x, y, z = (samples & _LAST).unbind(-1)
        return torch.where(ids >= 0, ids * ROWS + (x * BLOCK + y) * BLOCK + z, -1)

    def lookup_volume(self) -> tuple[Tensor, Tensor]:
        """Ids (X, Y, Z) int32 of the blocks around the origin (3,) int64, -1 where there is none."""
        return self._volume, self._origin

    def lookup(self) -> tuple[np.ndarray, np.ndarray]:
        """What compiled loops find rows by, on the CPU: ids (X, Y, Z) of the blocks around the origin (3,)."""
        return self._volume.numpy(), self._origin.numpy()

    def nearest_rows(self, points: Tensor) -> Tensor:
        """(..., 3) world points, metres -> (...) int64 row of the nearest sample, -1 where there is none."""
        return self.sample_rows(torch.round(points / self.voxel_size_m).long())

    def trilinear(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 3) world points -> rows (N, 8) int64 of the samples around (-1 = absent), weights (N, 8) float32."""
        scaled = points / self.voxel_size_m
        base = torch.floor(scaled)
        part = scaled - base
        corners = CORNERS.to(self.device)
        rows = self.sample_rows(base.long()[:, None, :] + corners)
        weights = torch.where(corners.bool(), part[:, None, :], 1 - part[:, None, :]).prod(-1)
        return rows, weights

    def inner_offsets(self) -> Tensor:
        """(512, 3) offsets of a block's samples from its first one, in row order, metres."""
        steps = torch.arange(BLOCK, device=self.device) * self.voxel_size_m
        return torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).view(ROWS, 3)

    def block_positions(self, ids: Tensor) -> Tensor:
        """(M,) ids -> (M, 512, 3) world positions of the samples in row order, metres."""
        return self.blocks[ids][:, None, :] * self.block_size_m + self.inner_offsets()

    def _cover(self, blocks: Tensor) -> None:
        """Grow the lookup volume until it holds `blocks`."""
        low, high = blocks.amin(0), blocks.amax(0) + 1
        if len(self.blocks):
            old_high = self._origin + torch.tensor(self._volume.shape, device=self.device)
            if bool((low >= self._origin).all() and (high <= old_high).all()):
                return
            low, high = torch.minimum(low, self._origin), torch.maximum(high, old_high)
        low, high = low - _MARGIN, high + _MARGIN
        volume = torch.full(tuple((high - low).tolist()), -1, dtype=torch.int32, device=self.device)
        x, y, z = (self.blocks - low).unbind(-1)
        volume[x, y, z] = torch.arange(len(self.blocks), dtype=torch.int32, device=self.device)
        self._origin, self._volume, self._shape = low, volume, high - low


def unique_blocks(blocks: Tensor) -> Tensor:
    """Distinct rows of (M, 3) int64 coordinates within +-2^20, sorted. Packed, hence 50 times quicker than dim=0."""
    half = 1 << 20
    x, y, z = (blocks + half).unbind(-1)
    keys = torch.unique((x << 42) | (y << 21) | z)
    mask = (1 << 21) - 1
    return torch.stack([keys >> 42, (keys >> 21) & mask, keys & mask], -1) - half


@compiled()
def row_of(x: Index, y: Index, z: Index, volume: np.ndarray, origin: np.ndarray) -> Index:
    """`SparseGrid.sample_rows` of one sample, for compiled loops; volume and origin from `SparseGrid.lookup`."""
    i, j, k = (x >> BLOCK_BITS) - origin[0], (y >> BLOCK_BITS) - origin[1], (z >> BLOCK_BITS) - origin[2]
    if i < 0 or j < 0 or k < 0 or i >= volume.shape[0] or j >= volume.shape[1] or k >= volume.shape[2]:
        return -1
    block = np.int64(volume[i, j, k])
    row = block * ROWS + (((x & _LAST) * BLOCK + (y & _LAST)) * BLOCK + (z & _LAST))
    return row if block >= 0 else -1


@compiled()
def _rows_of(samples: np.ndarray, volume: np.ndarray, origin: np.ndarray) -> np.ndarray:
    rows = np.empty(len(samples), np.int64)
    for index in range(len(samples)):
        rows[index] = row_of(samples[index, 0], samples[index, 1], samples[index, 2], volume, origin)
    return rows


CORNERS = torch.tensor([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
