"""Intersection of rays with the zero level of a sampled signed distance."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ..core.compiled import compiled
from .sparse_grid import SparseGrid, row_of

CHUNK = 8192  # rays at a time: about 100 MB
_FINE = 9  # interpolated samples around a coarse crossing


def cast_rays(
    grid: SparseGrid, sdf: Tensor, known: Tensor, origins: Tensor, directions: Tensor, far_m: float, step_m: float
) -> Tensor:
    """First crossing from free space into a surface, as z-depth.

    sdf (R,) metres and known (R,) bool by grid row; origins (N, 3); directions (N, 3) with unit z-component in the
    camera (`Camera.rays`, rotated). `step_m` must not exceed the truncation. Returns (N,) metres, 0 = no hit.
    """
    if sdf.device.type == "cpu":
        starts, rays = (np.ascontiguousarray(part.numpy(), dtype=np.float32) for part in (origins, directions))
        steps = int(far_m / step_m) + 1
        depth = _march(starts, rays, sdf.numpy(), known.numpy(), *grid.lookup(), grid.voxel_size_m, step_m, steps)
        return torch.from_numpy(depth)
    return cast_tensors(grid, sdf, known, origins, directions, far_m, step_m)


def cast_tensors(
    grid: SparseGrid, sdf: Tensor, known: Tensor, origins: Tensor, directions: Tensor, far_m: float, step_m: float
) -> Tensor:
    """`cast_rays` on any device, as plain tensor operations; the tests compare the compiled loop with it."""
    depth = torch.zeros(len(directions), device=directions.device)
    steps = torch.arange(1, int(far_m / step_m) + 2, device=directions.device) * step_m
    for start in range(0, len(directions), CHUNK):
        part = slice(start, start + CHUNK)
        depth[part] = _cast(grid, sdf, known, origins[part], directions[part], steps, step_m)
    return depth


def _cast(
    grid: SparseGrid, sdf: Tensor, known: Tensor, origins: Tensor, directions: Tensor, steps: Tensor, step_m: float
) -> Tensor:
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


@compiled()
def _march(
    origins: np.ndarray, directions: np.ndarray, sdf: np.ndarray, known: np.ndarray, volume: np.ndarray,
    origin: np.ndarray, far: np.ndarray | None, voxel: float, step: float, steps: int,
) -> np.ndarray:  # fmt: skip
    """Coarse steps by the nearest sample until the sign changes; then interpolated ones around that place.

    Positions are counted in voxels.
    """
    depth = np.zeros(len(directions), np.float32)
    start, direction = np.empty(3), np.empty(3)
    for ray in range(len(directions)):
        for axis in range(3):
            start[axis], direction[axis] = origins[ray, axis] / voxel, directions[ray, axis] / voxel
        before = np.nan
        for count in range(1, steps + 1):
            z = count * step
            x, y = np.rint(start[0] + direction[0] * z), np.rint(start[1] + direction[1] * z)
            w = np.rint(start[2] + direction[2] * z)
            row = row_of(np.int64(x), np.int64(y), np.int64(w), volume, origin, far)
            value = sdf[row] if row >= 0 and known[row] else np.nan
            if before > 0 and value <= 0:
                depth[ray] = _refined(start, direction, z - 1.5 * step, 2.0 * step / (_FINE - 1), sdf, known, volume,
                                      origin, far)  # fmt: skip
                break
            before = value
    return depth


@compiled()
def _refined(
    start: np.ndarray, direction: np.ndarray, first: float, spacing: float, sdf: np.ndarray, known: np.ndarray,
    volume: np.ndarray, origin: np.ndarray, far: np.ndarray | None,
) -> float:  # fmt: skip
    before, z = np.nan, first
    for _ in range(_FINE):
        value = _interpolated(start, direction, z, sdf, known, volume, origin, far)
        if before > 0 and value <= 0:
            return z - spacing * value / (value - before)
        before = value
        z += spacing
    return 0.0


@compiled()
def _interpolated(
    start: np.ndarray, direction: np.ndarray, z: float, sdf: np.ndarray, known: np.ndarray, volume: np.ndarray,
    origin: np.ndarray, far: np.ndarray | None,
) -> float:  # fmt: skip
    """Trilinear distance at the point; NaN where one of the samples around is not known."""
    x, y, w = start[0] + direction[0] * z, start[1] + direction[1] * z, start[2] + direction[2] * z
    i, j, k = np.int64(np.floor(x)), np.int64(np.floor(y)), np.int64(np.floor(w))
    x, y, w = x - i, y - j, w - k
    total = 0.0
    for corner in range(8):
        a, b, c = corner >> 2, (corner >> 1) & 1, corner & 1
        row = row_of(i + a, j + b, k + c, volume, origin, far)
        if row < 0 or not known[row]:
            return np.nan
        total += sdf[row] * (x if a else 1 - x) * (y if b else 1 - y) * (w if c else 1 - w)
    return total
