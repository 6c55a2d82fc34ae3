"""Samples along rays, at equal steps within the voxels that they pass through."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .intersect import Hits


@dataclass(frozen=True)
class Samples:
    """Samples of N rays, near to far, padded to the longest ray.

    z (N, S) metres; there (N, S) bool, whether the sample exists; voxels (N, S) int64 ids, 0 where it does not;
    index (M,) int64, where the M existing ones stand in the flattened (N * S).
    """

    z: Tensor
    there: Tensor
    voxels: Tensor
    index: Tensor

    def of_rays(self, first: int, last: int) -> Samples:
        """Those of rays first:last."""
        there = self.there[first:last]
        index = there.reshape(-1).nonzero()[:, 0]
        return Samples(self.z[first:last], there, self.voxels[first:last], index)

    def packed(self) -> tuple[Tensor, Tensor, Tensor]:
        """Ray (M,), z (M,) and voxel (M,) of the existing samples."""
        return self.index // self.z.shape[1], self.z.reshape(-1)[self.index], self.voxels.reshape(-1)[self.index]

    def pad(self, values: Tensor) -> Tensor:
        """(M,) or (M, C) values of the existing samples -> (N, S) or (N, S, C), 0 elsewhere; differentiable."""
        flat = values.new_zeros(self.z.numel(), *values.shape[1:])
        return flat.index_copy(0, self.index, values).view(*self.z.shape, *values.shape[1:])


def place_samples(hits: Hits, step_m: float, offset: Tensor) -> Samples:
    """Samples every `step_m` along the way that rays have within voxels, gaps between voxels left out.

    offset (N,) in 0..1 shifts the samples of a ray by that share of a step. The step is a z-depth, as all distances
    along a ray here.
    """
    lengths = hits.exit - hits.entry
    reached = torch.cumsum(lengths, 1)
    counts = torch.ceil(reached[:, -1] / step_m - offset).long().clamp(min=0)
    longest, total = torch.stack([counts.max(), counts.sum()]).tolist() if len(counts) else (0, 0)
    ordinal = torch.arange(longest, device=counts.device)
    there = ordinal < counts[:, None]
    way = (ordinal + offset[:, None]) * step_m
    last = (hits.ids >= 0).sum(1, keepdim=True).clamp(min=1) - 1
    hit = torch.minimum(torch.searchsorted(reached, way, right=True), last)
    z = hits.entry.gather(1, hit) + way - (reached - lengths).gather(1, hit)
    voxels = hits.ids.gather(1, hit).clamp(min=0)
    return Samples(z, there, voxels, _places(counts, longest, total))


def _places(counts: Tensor, longest: int, total: int) -> Tensor:
    """Where the first counts[n] places of row n stand in a flattened (N, longest); `total` in all."""
    row = torch.repeat_interleave(torch.arange(len(counts), device=counts.device), counts, output_size=total)
    before = torch.cumsum(counts, 0) - counts
    return torch.arange(total, device=counts.device) - before[row] + row * longest
