"""Dense feature grids over a box, with trilinear lookups that are differentiable in table and position.

32 channels, float32. Vertices lie ON the faces of the box (align_corners), so the pitch is length / (vertices - 1);
positions outside read the border (docs/uncle-paper.md, Scene representation).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.errors import DataError
from .decoders import CHANNELS

MAX_VERTICES = 1 << 25  # of a grid: 4 GB of features


@dataclass
class FeatureGrid:
    """Features at the vertices of a regular grid.

    low, pitch (3,) metres; shape: vertices along x, y, z; table (X * Y * Z, 32), z fastest; std of new features.
    """

    low: Tensor
    pitch: Tensor
    shape: tuple[int, int, int]
    table: Tensor
    std: float

    def __post_init__(self) -> None:
        """Put what lookups need on the device, once."""
        self._steps = torch.tensor(_CORNERS, device=self.low.device)
        self._last = torch.tensor(self.shape, device=self.low.device) - 1

    @staticmethod
    def over(
        bound: Tensor, voxel_m: float, std: float, generator: torch.Generator, device: torch.device
    ) -> FeatureGrid:
        """A grid of N(0, std^2) over bound (2, 3) metres: round(length / voxel) vertices an axis, at least 2."""
        length = (bound[1] - bound[0]).double().cpu()
        x, y, z = (max(2, round(float(size) / voxel_m)) for size in length)
        shape = (x, y, z)
        pitch = (length / (torch.tensor(shape) - 1)).float().to(device)
        _require_room(shape, bound)
        table = torch.empty(math.prod(shape), CHANNELS).normal_(0.0, std, generator=generator)
        return FeatureGrid(bound[0].float().to(device), pitch, shape, table.to(device), std)

    def grown(self, bound: Tensor, generator: torch.Generator) -> FeatureGrid:
        """The grid with as many vertices added on each side as it takes to include bound (2, 3); old ones stay."""
        low, high = self.low, self.low + self.pitch * self._last
        before = torch.ceil((low - bound[0].to(low)) / self.pitch - 1e-3).clamp(min=0).long().tolist()
        after = torch.ceil((bound[1].to(low) - high) / self.pitch - 1e-3).clamp(min=0).long().tolist()
        shape = tuple(a + n + b for a, n, b in zip(before, self.shape, after, strict=True))
        _require_room(shape, bound)
        table = torch.empty(*shape, CHANNELS).normal_(0.0, self.std, generator=generator).to(self.table.device)
        old = tuple(slice(a, a + n) for a, n in zip(before, self.shape, strict=True))
        table[old] = self.table.view(*self.shape, CHANNELS)
        start = low - self.pitch * torch.tensor(before, device=low.device)
        return FeatureGrid(start, self.pitch, shape, table.view(-1, CHANNELS), self.std)

    def vertices(self) -> Tensor:
        """(X * Y * Z, 3) positions, metres."""
        axes = [torch.arange(n, device=self.low.device) for n in self.shape]
        steps = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).view(-1, 3)
        return self.low + steps * self.pitch

    def corners(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """(N, 3) -> rows (N, 8) int64 of the vertices around, weights (N, 8), differentiable in the points."""
        place = torch.minimum(((points - self.low) / self.pitch).clamp(min=0), self._last.to(points.dtype))
        base = torch.minimum(place.detach().floor(), (self._last - 1).to(points.dtype))
        part = place - base
        cell = base.long()[:, None] + self._steps
        rows = (cell[..., 0] * self.shape[1] + cell[..., 1]) * self.shape[2] + cell[..., 2]
        weights = torch.where(self._steps.bool(), part[:, None], 1 - part[:, None]).prod(-1)
        return rows, weights

    def lookup(self, points: Tensor) -> Tensor:
        """Features (N, 32) at points (N, 3), metres."""
        return _WeightedRows.apply(self.table, *self.corners(points))

    def to_state(self) -> dict[str, Any]:
        """Plain tensors for `from_state`."""
        return {"low": self.low, "pitch": self.pitch, "shape": list(self.shape), "table": self.table.detach(),
                "std": self.std}  # fmt: skip

    @staticmethod
    def from_state(state: dict[str, Any], device: torch.device) -> FeatureGrid:
        """The grid that `to_state` describes."""
        low, pitch, table = (state[name].to(device) for name in ("low", "pitch", "table"))
        return FeatureGrid(low, pitch, tuple(state["shape"]), table, state["std"])


_CORNERS = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]


class _WeightedRows(torch.autograd.Function):
    """sum over k of weights (N, K) * table (V, C)[rows (N, K)]; gradients of table and weights without sorting."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, rows: Tensor, weights: Tensor) -> Tensor:
        ctx.save_for_backward(table, rows, weights)
        return torch.nn.functional.embedding_bag(rows, table.detach(), mode="sum", per_sample_weights=weights.detach())

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, None, Tensor | None]:
        table, rows, weights = ctx.saved_tensors
        of_table = of_weights = None
        if ctx.needs_input_grad[0]:
            spread = (weights[..., None] * grad[:, None]).view(-1, grad.shape[1])
            of_table = torch.zeros_like(table).index_add_(0, rows.view(-1), spread)
        if ctx.needs_input_grad[2]:
            of_weights = torch.stack([(table[row] * grad).sum(-1) for row in rows.unbind(1)], 1)
        return of_table, None, of_weights


def _require_room(shape: tuple[int, ...], bound: Tensor) -> None:
    """Raises DataError for a grid that would not fit into memory."""
    if math.prod(shape) > MAX_VERTICES:
        sides = " x ".join(f"{side:.0f}" for side in (bound[1] - bound[0]).tolist())
        raise DataError(
            f"the dense grids of this method cannot cover a box of {sides} m: leave out frames that are far from the "
            "others (uncle preprocess --frames), or set nice.bound"
        )
