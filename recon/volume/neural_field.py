"""The neural field: signed distance and colour from learned features on a sparse, multi-resolution grid.

The finest level holds a distance and a colour at each sample near the surface, warm-started by fusion; coarser levels
hold feature vectors that a small decoder turns into a smooth correction of both. With the decoder's last layer at zero
the field starts as the fused map, and every part of it is then moved by the rendering likelihood.
"""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor, nn

from ..core.config.uncle import FieldConfig
from .interpolation import weighted_rows
from .sparse_grid import BLOCK, ROWS, SparseGrid, unique_blocks
from .tsdf_volume import TsdfVolume

ACTIVE_VOXELS = 3.0  # samples this close to the surface can be moved
MIN_CORNER_WEIGHT = 1e-4  # a corner with less need not be known: vertices lie on the edges of cells, also of the last
_POINTS_AT_A_TIME = 1 << 17


class FeatureLevel(nn.Module):
    """Feature vectors (R, C) on a coarser sparse grid, interpolated trilinearly."""

    def __init__(self, grid: SparseGrid, channels: int, generator: torch.Generator) -> None:
        super().__init__()
        self.grid = grid
        start = torch.empty(grid.rows, channels).normal_(std=0.01, generator=generator)
        self.features = nn.Parameter(start.to(grid.device))

    def forward(self, points: Tensor) -> Tensor:
        """(N, 3) -> (N, C)."""
        rows, weights = self.grid.trilinear(points)
        weights = weights * (rows >= 0)
        return weighted_rows(self.features, rows.clamp(min=0), weights)


class NeuralField(nn.Module):
    """sdf(x) in metres and colour(x) in 0..1.

    base    (R, 4) fused sdf and rgb of every sample
    sigma   (R,) standard deviation of that sdf, metres
    known   (R,) whether the sample has enough observations
    fine    (A + 1, 4) learned offsets of the A active samples; the first row, of all others, stays zero
    """

    def __init__(
        self,
        grid: SparseGrid,
        base: Tensor,
        sigma: Tensor,
        known: Tensor,
        config: FieldConfig,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        self.grid, self.base, self.sigma, self.known, self.config = grid, base, sigma, known, config
        active = (known & (base[:, 0].abs() < ACTIVE_VOXELS * grid.voxel_size_m)).nonzero()[:, 0]
        self.slot = torch.zeros(grid.rows, dtype=torch.int64, device=grid.device)
        self.slot[active] = torch.arange(1, len(active) + 1, device=grid.device)
        self.fine = nn.Parameter(torch.zeros(len(active) + 1, 4, device=grid.device))  # slot 0 stays zero
        self.levels = nn.ModuleList(
            FeatureLevel(_coarser(grid, factor, active), config.channels, generator) for factor in config.levels
        )
        self.decoder = _decoder(config.channels * max(1, len(config.levels)), config.hidden, generator).to(grid.device)

    @classmethod
    def from_fusion(
        cls,
        volume: TsdfVolume,
        min_observations: float,
        config: FieldConfig,
        generator: torch.Generator,
        weight_scale_m: float | None = None,
    ) -> NeuralField:
        """The field that equals the fused map; samples with fewer than `min_observations` are unknown to it.

        `weight_scale_m`: the weights are inverse variances, as in `Samples.propagated_sigma`; None: they are not.
        """
        fused = volume.samples()
        sigma = fused.sigma if weight_scale_m is None else fused.propagated_sigma(weight_scale_m)
        base = torch.cat([fused.sdf[:, None], fused.colors], 1)
        return cls(volume.grid, base, sigma, volume.counts() >= min_observations, config, generator)

    def forward(self, points: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(N, 3) world points -> sdf (N,) metres, rgb (N, 3), known (N,) bool; sdf and rgb are 0 where unknown."""
        rows, weights = self.grid.trilinear(points)
        known = ((rows >= 0) & self.known[rows.clamp(min=0)] | (weights < MIN_CORNER_WEIGHT)).all(1)
        rows = rows.clamp(min=0)
        fixed = (self.base[rows] * weights[..., None]).sum(1)
        slots = self.slot[rows]
        fine = weighted_rows(
            self.fine, slots, weights * (slots > 0)
        )  # slot 0 must not be trained: all free space shares it
        values = fixed + fine + self.correction(points)
        values = values * known[:, None]
        return values[:, 0], values[:, 1:], known

    def correction(self, points: Tensor) -> Tensor:
        """(N, 3) -> (N, 4): correction by the coarse features, of sdf within +- 2 voxels, of colour within +- 1."""
        if not self.levels or len(self.fine) == 1:  # no feature grid, or no sample near a surface to make one for
            return points.new_zeros(len(points), 4)
        features = torch.cat([level(points) for level in self.levels], 1)
        scale = points.new_tensor([2 * self.grid.voxel_size_m, 1.0, 1.0, 1.0])
        return torch.tanh(self.decoder(features)) * scale

    @torch.no_grad()
    def samples(self, ids: Tensor, voxels: float = ACTIVE_VOXELS) -> tuple[Tensor, Tensor]:
        """(M,) block ids -> sdf (M, 512) metres, and whether it is known; corrected within `voxels` of the surface."""
        rows = (ids[:, None] * ROWS + torch.arange(ROWS, device=ids.device)).view(-1)
        sdf = self.base[rows, 0] + self.fine[self.slot[rows], 0]
        near = (self.known[rows] & (sdf.abs() < voxels * self.grid.voxel_size_m)).nonzero()[:, 0]
        points = self.grid.block_positions(ids).view(-1, 3)
        for part in near.split(_POINTS_AT_A_TIME):
            sdf[part] += self.correction(points[part])[:, 0]
        return sdf.view(-1, ROWS), self.known[rows].view(-1, ROWS)

    @torch.no_grad()
    def sdf_table(self) -> Tensor:
        """(R,) sdf of every sample."""
        ids = torch.arange(len(self.grid.blocks), device=self.grid.device)
        return torch.cat([self.samples(part)[0].view(-1) for part in ids.split(1024)])

    def to_state(self) -> dict[str, Any]:
        """Plain tensors and numbers for `from_state`."""
        return {
            "voxel_size_m": self.grid.voxel_size_m,
            "blocks": self.grid.blocks,
            "sdf": self.base[:, 0],
            "rgb": (self.base[:, 1:] * 255).round().to(torch.uint8),
            "sigma": self.sigma.half(),
            "known": self.known,
            "config": self.config.model_dump(mode="json"),
            "parameters": self.state_dict(),
        }

    @classmethod
    def from_state(cls, state: dict[str, Any], device: torch.device | str = "cpu") -> NeuralField:
        """The field that `to_state` describes."""
        grid = SparseGrid(state["voxel_size_m"], device)
        grid.restore(state["blocks"].to(device))
        base = torch.cat([state["sdf"][:, None], state["rgb"].float() / 255], 1).to(device)
        config = FieldConfig.model_validate(state["config"])
        sigma, known = state["sigma"].float().to(device), state["known"].to(device)
        field = cls(grid, base, sigma, known, config, torch.Generator())
        field.load_state_dict(state["parameters"])
        return field


def _coarser(grid: SparseGrid, factor: int, active: Tensor) -> SparseGrid:
    """A grid of `factor` times the voxel size that covers the blocks with active samples."""
    coarse = SparseGrid(grid.voxel_size_m * factor, grid.device)
    blocks = grid.blocks[torch.unique(active // ROWS)]
    if len(blocks):
        ends = torch.stack(
            [blocks * BLOCK, blocks * BLOCK + BLOCK - 1, blocks * BLOCK + BLOCK - 1 + factor]
        )  # with the upper neighbour cell
        corners = torch.div(torch.div(ends, factor, rounding_mode="floor"), BLOCK, rounding_mode="floor")
        spans = [torch.stack([corners[i, :, 0], corners[j, :, 1], corners[k, :, 2]], 1)
                 for i in range(3) for j in range(3) for k in range(3)]  # fmt: skip
        coarse.allocate(unique_blocks(torch.cat(spans)))
    return coarse


def _decoder(inputs: int, hidden: int, generator: torch.Generator) -> nn.Sequential:
    """inputs -> hidden -> 4; the last layer starts at zero."""
    first, last = nn.Linear(inputs, hidden), nn.Linear(hidden, 4)
    with torch.no_grad():
        bound = math.sqrt(6 / (inputs + hidden))
        first.weight.uniform_(-bound, bound, generator=generator)
        for values in (first.bias, last.weight, last.bias):
            values.zero_()
    return nn.Sequential(first, nn.ReLU(), last)
