"""Where rays meet the zero level of a sampled signed distance: the proposals of the renderer and the learner."""

from __future__ import annotations

import torch
from torch import Tensor

from .grid import SparseGrid

CHUNK = 8192  # rays at a time: about 100 MB
_FINE = 9  # interpolated samples around a coarse crossing


def cast_rays(
    grid: SparseGrid, sdf: Tensor, known: Tensor, origins: Tensor, directions: Tensor, far_m: float, step_m: float
) -> Tensor:
    """First crossing from free space into a surface, as z-depth.

    sdf (R,) metres and known (R,) bool by grid row; origins (N, 3); directions (N, 3) with unit z-component in the
    camera (`Camera.rays`, rotated). `step_m` must not exceed the truncation. Returns (N,) metres, 0 = no hit.
    """
    depth = torch.zeros(len(directions), device=directions.device)
    steps = torch.arange(1, int(far_m / step_m) + 2, device=directions.device) * step_m
    for start in range(0, len(directions), CHUNK):
        part = slice(start, start + CHUNK)
        depth[part] = _cast(grid, sdf, known, origins[part], directions[part], steps, step_m)
    return depth


def _cast(grid, sdf, known, origins, directions, steps, step_m) -> Tensor:
    depth = torch.zeros(len(directions), device=directions.device)
    rows = grid.nearest_rows(origins[:, None] + directions[:, None] * steps[:, None])
    values = torch.where((rows >= 0) & known[rows.clamp(min=0)], sdf[rows.clamp(min=0)], torch.nan)
    crossing, first = _first_crossing(values)
    hit = crossing.nonzero()[:, 0]
    if len(hit) == 0:
        return depth
    fine = steps[first[hit], None] + torch.linspace(-0.5, 1.5, _FINE, device=steps.device) * step_m
    points = origins[hit, None] + directions[hit, None] * fine[..., None]
    rows, weights = grid.trilinear(points.view(-1, 3))
    whole = ((rows >= 0) & known[rows.clamp(min=0)]).all(1)
    values = torch.where(whole, (sdf[rows.clamp(min=0)] * weights).sum(1), torch.nan).view(-1, _FINE)
    crossing, first = _first_crossing(values)
    ray = torch.arange(len(hit), device=steps.device)
    before, after = values[ray, first], values[ray, first + 1]
    z = fine[ray, first] + (fine[ray, first + 1] - fine[ray, first]) * before / (before - after)
    depth[hit] = torch.where(crossing, z, 0.0)
    return depth


def _first_crossing(values: Tensor) -> tuple[Tensor, Tensor]:
    """(N, S) with nan = unknown -> whether a positive value is followed by a negative one, where first; (N,) each."""
    crossing = (values[:, :-1] > 0) & (values[:, 1:] <= 0)
    return crossing.any(1), crossing.int().argmax(1)
