"""The map at points between its samples: distance, its sigma and grey value, with gradients (trilinear)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..core.compiled import compiled
from .sparse_grid import CORNERS, row_of
from .tsdf_volume import ERROR_CORRELATION, MIN_SIGMA_M, TsdfVolume

_COLUMNS = 9  # of the values of the compiled loop: sdf, gradient, sigma, grey, its gradient


@dataclass(frozen=True)
class TsdfQuery:
    """The map at the K of N points whose eight surrounding samples are all observed.

    kept           (K,) int64 indices of these points
    sdf            (K,) metres, signed distance from the surface
    gradient       (K, 3) of it
    sigma          (K,) metres, its standard deviation
    grey           (K,) 0..1
    grey_gradient  (K, 3) 1 / metre
    """

    kept: Tensor
    sdf: Tensor
    gradient: Tensor
    sigma: Tensor
    grey: Tensor
    grey_gradient: Tensor


def query_numba(volume: TsdfVolume, points: Tensor, T_world_points: Tensor) -> TsdfQuery:
    """The map at points (N, 3) moved by T_world_points (4, 4), on the CPU: `query_torch` as one compiled loop."""
    values, kept = np.empty((len(points), _COLUMNS), np.float32), np.empty(len(points), np.int64)
    count = _query_loop(
        points.numpy(), T_world_points[:3, :3].numpy(), T_world_points[:3, 3].numpy(), volume.sums.numpy(),
        volume.color_sums.numpy(), *volume.grid.lookup(), volume.grid.voxel_size_m, ERROR_CORRELATION, MIN_SIGMA_M,
        values, kept,
    )  # fmt: skip
    columns = torch.from_numpy(values[:count])
    sdf, gradient, sigma, grey, grey_gradient = columns.split([1, 3, 1, 1, 3], 1)
    return TsdfQuery(torch.from_numpy(kept[:count]), sdf[:, 0], gradient, sigma[:, 0], grey[:, 0], grey_gradient)


def query_torch(volume: TsdfVolume, points: Tensor, T_world_points: Tensor) -> TsdfQuery:
    """The map at points (N, 3) moved by T_world_points (4, 4), on any device, as tensor operations.

    The tests compare it with `query_numba`.
    """
    world = points @ T_world_points[:3, :3].T + T_world_points[:3, 3]
    rows, weights = volume.grid.trilinear(world)
    observed = (rows >= 0) & (volume.sums[rows.clamp(min=0), 3] >= 1)
    kept = observed.all(1).nonzero()[:, 0]
    corners, weights = CORNERS.to(world.device), weights[kept]
    part = world[kept] / volume.grid.voxel_size_m
    part = part - part.floor()
    factors = torch.where(corners.bool(), part[:, None], 1 - part[:, None])  # (K, 8, 3)
    x, y, z = factors.unbind(-1)
    slopes = torch.stack([y * z, x * z, x * y], -1) * (2.0 * corners - 1) / volume.grid.voxel_size_m
    samples = volume.samples(rows[kept])
    grey = samples.colors.mean(-1)
    sdf, gradient = _interpolated(samples.sdf, weights, slopes)
    return TsdfQuery(kept, sdf, gradient, (samples.sigma * weights).sum(-1), *_interpolated(grey, weights, slopes))


def _interpolated(values: Tensor, weights: Tensor, slopes: Tensor) -> tuple[Tensor, Tensor]:
    """values (K, 8) at the corners -> value (K,) and gradient (K, 3)."""
    return (values * weights).sum(-1), (values[..., None] * slopes).sum(1)


@compiled()
def _query_loop(
    points: np.ndarray, rotation: np.ndarray, shift: np.ndarray, sums: np.ndarray, color_sums: np.ndarray,
    volume: np.ndarray, origin: np.ndarray, far: np.ndarray | None, voxel: float, error_correlation: float,
    min_sigma: float, values: np.ndarray, kept: np.ndarray,
) -> int:  # fmt: skip
    """Fills `values` (N, _COLUMNS) and `kept` (N,); returns how many points are inside the map."""
    count, rows, place = 0, np.empty(8, np.int64), np.empty(3)
    for point in range(len(points)):
        for axis in range(3):
            place[axis] = shift[axis]
            for other in range(3):
                place[axis] += rotation[axis, other] * points[point, other]
        if not _corners(place, voxel, sums, volume, origin, far, rows):
            continue
        kept[count] = point
        _blend(place, voxel, rows, sums, color_sums, error_correlation, min_sigma, values[count])
        count += 1
    return count


@compiled(inline="always")
def _corners(
    place: np.ndarray,
    voxel: float,
    sums: np.ndarray,
    volume: np.ndarray,
    origin: np.ndarray,
    far: np.ndarray | None,
    rows: np.ndarray,
) -> bool:
    """The rows of the samples around `place`, which becomes its place between them, 0..1; whether all are known."""
    i, j, k = (np.int64(np.floor(place[0] / voxel)), np.int64(np.floor(place[1] / voxel)),
               np.int64(np.floor(place[2] / voxel)))  # fmt: skip
    place[0], place[1], place[2] = place[0] / voxel - i, place[1] / voxel - j, place[2] / voxel - k
    for corner in range(8):
        row = row_of(i + (corner >> 2), j + ((corner >> 1) & 1), k + (corner & 1), volume, origin, far)
        if row < 0 or sums[row, 3] < 1:
            return False
        rows[corner] = row
    return True


@compiled(inline="always")
def _blend(
    part: np.ndarray, voxel: float, rows: np.ndarray, sums: np.ndarray, color_sums: np.ndarray,
    error_correlation: float, min_sigma: float, result: np.ndarray,
) -> None:  # fmt: skip
    result[:] = 0
    for corner in range(8):
        row = rows[corner]
        x = part[0] if corner >> 2 else 1 - part[0]
        y = part[1] if (corner >> 1) & 1 else 1 - part[1]
        z = part[2] if corner & 1 else 1 - part[2]
        weight = max(sums[row, 0], 1e-12)
        sdf = sums[row, 1] / weight
        spread = max(sums[row, 2] / weight - sdf * sdf, 0.0)
        sigma = np.sqrt(spread * (error_correlation + (1 - error_correlation) / max(sums[row, 3], 1.0)))
        seen = color_sums[row, 0]
        shade = color_sums[row, 1] + color_sums[row, 2] + color_sums[row, 3]
        grey = shade / (3 * 255.0 * seen) if seen > 0 else 0.5
        a = y * z * (1 if corner >> 2 else -1) / voxel
        b = x * z * (1 if (corner >> 1) & 1 else -1) / voxel
        c = x * y * (1 if corner & 1 else -1) / voxel
        result[0] += x * y * z * sdf
        result[1] += a * sdf
        result[2] += b * sdf
        result[3] += c * sdf
        result[4] += x * y * z * max(sigma, min_sigma)
        result[5] += x * y * z * grey
        result[6] += a * grey
        result[7] += b * grey
        result[8] += c * grey
