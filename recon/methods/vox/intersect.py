"""Which voxels a ray passes through, and from where to where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...core.compiled import compiled
from ...volume.block_index import block_of
from ...volume.sparse_grid import SparseGrid

_MOST_PLANES = 2048  # a GPU cuts each ray by all planes between voxels; of more, the compiled loop is quicker
_THIN = 1e-6  # metres: a corner that is merely touched is not passed through


@dataclass(frozen=True)
class Hits:
    """The first voxels on each of N rays, near to far: ids (N, H) int64, -1 = no more; entry and exit (N, H), as
    z-depth in metres, both 0 where there is none."""

    ids: Tensor
    entry: Tensor
    exit: Tensor


def intersect(voxels: SparseGrid, origins: Tensor, directions: Tensor, far: Tensor, most: int) -> Hits:
    """The first `most` voxels (blocks of `voxels`) that rays pass through before `far` (N,), z-depth in metres.

    origins (N, 3), metres; directions (N, 3) with unit z-component in the camera (`Camera.rays`, rotated).
    """
    low, shape = (part.cpu().numpy() for part in voxels.extent())
    if origins.device.type != "cpu" and shape.sum() <= _MOST_PLANES:
        return intersect_tensors(voxels, origins, directions, far, most)
    starts, ways, ends = (
        np.ascontiguousarray(part.detach().cpu().numpy(), np.float32) for part in (origins, directions, far)
    )
    found = _walk(starts, ways, ends, *voxels.lookup(), low, shape, voxels.block_size_m, most)
    return Hits(*(torch.from_numpy(part).to(origins.device) for part in found))


def intersect_tensors(voxels: SparseGrid, origins: Tensor, directions: Tensor, far: Tensor, most: int) -> Hits:
    """`intersect` on any device, as plain tensor operations, without waiting for the device.

    A ray is cut by all planes between voxels; each piece lies in the voxel that holds its middle.
    """
    size, (low, shape) = voxels.block_size_m, voxels.extent()
    start = origins / size - low
    direction = directions / size
    planes = [
        (torch.arange(int(shape[axis]) + 1, device=start.device) - start[:, axis, None]) / direction[:, axis, None]
        for axis in range(3)
    ]
    reach = torch.where(torch.isfinite(far), far, 1e6)[:, None]
    cuts = torch.cat(planes, 1).nan_to_num(nan=0.0, posinf=1e6, neginf=0.0)
    edges = torch.minimum(cuts.clamp(min=0.0), reach).sort(1).values
    edges = torch.cat([torch.zeros_like(reach), edges], 1)
    entry, exit = edges[:, :-1], edges[:, 1:]
    middle = (entry + exit) / 2
    cells = torch.floor(start[:, None] + direction[:, None] * middle[..., None]).long() + low
    ids = torch.where(exit - entry > _THIN, voxels.block_ids(cells), -1)
    rank = torch.cumsum(ids >= 0, 1)
    slot = torch.where((ids >= 0) & (rank <= most), rank - 1, most)  # all that is not wanted falls into a spare column

    def first(values: Tensor, fill: float) -> Tensor:
        return values.new_full((len(values), most + 1), fill).scatter(1, slot, values)[:, :most]

    return Hits(first(ids, -1), first(entry, 0.0), first(exit, 0.0))


@compiled()
def _walk(
    origins: np.ndarray, directions: np.ndarray, ends: np.ndarray, volume: np.ndarray, origin: np.ndarray,
    far: np.ndarray | None, low: np.ndarray, shape: np.ndarray, size: float, most: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """From voxel to voxel, always through the nearest of the three planes ahead."""
    count = len(origins)
    ids = np.full((count, most), -1, np.int64)
    entry, exit = np.zeros((count, most), np.float32), np.zeros((count, most), np.float32)
    cell, step = np.empty(3, np.int64), np.empty(3, np.int64)
    ahead, pitch = np.empty(3), np.empty(3)
    for ray in range(count):
        first, last = _clip(origins[ray], directions[ray], shape, low, size, ends[ray])
        if last <= first:
            continue
        for axis in range(3):
            slope = np.float64(directions[ray, axis]) / size
            start = origins[ray, axis] / size - low[axis]
            place = start + slope * first
            cell[axis] = min(max(np.int64(np.floor(place)), 0), shape[axis] - 1)
            step[axis] = 1 if slope > 0 else -1
            pitch[axis] = 1 / abs(slope) if slope != 0 else np.inf
            face = cell[axis] + (1 if slope > 0 else 0)
            ahead[axis] = (face - start) / slope if slope != 0 else np.inf
        z, found = first, 0
        while z < last and found < most:
            axis = 0 if ahead[0] <= ahead[1] and ahead[0] <= ahead[2] else (1 if ahead[1] <= ahead[2] else 2)
            leave = min(ahead[axis], last)
            block = block_of(cell[0] + low[0], cell[1] + low[1], cell[2] + low[2], volume, origin, far)
            if block >= 0 and leave - z > _THIN:
                ids[ray, found], entry[ray, found], exit[ray, found] = block, z, leave
                found += 1
            z = max(leave, z)
            cell[axis] += step[axis]
            ahead[axis] += pitch[axis]
            if cell[axis] < 0 or cell[axis] >= shape[axis]:
                break
    return ids, entry, exit


@compiled()
def _clip(
    origin: np.ndarray, direction: np.ndarray, shape: np.ndarray, low: np.ndarray, size: float, far: float
) -> tuple[float, float]:
    """The part of a ray within the box of all voxels, from 0 to `far` at most."""
    first, last = 0.0, np.float64(far)
    for axis in range(3):
        start, slope = origin[axis] / size - low[axis], np.float64(direction[axis]) / size
        if slope == 0:
            if start < 0 or start >= shape[axis]:
                return 0.0, 0.0
            continue
        a, b = -start / slope, (shape[axis] - start) / slope
        first, last = max(first, min(a, b)), min(last, max(a, b))
    return first, last
