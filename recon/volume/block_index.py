"""From the coordinates of a block to its id, in memory that grows with the number of blocks, not with their extent.

Most blocks lie in one box, in which a dense array finds them at once. The box is as large as a multiple of the number
of blocks allows; those outside it, such as the surroundings of a frame whose pose is far off, are found by a binary
search in a sorted table.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..core.compiled import compiled

Index = int | np.int64
_BITS = 21  # of a coordinate in a key: three fit into 63 bits
RANGE = 1 << (_BITS - 1)  # coordinates lie in [-RANGE, RANGE)
_MASK = (1 << _BITS) - 1
_MARGIN = 8  # blocks of slack when the box grows, so that it does not grow with every frame
_MIN_CELLS = 1 << 22  # cells of the box that are always allowed: 16 MB
_CELLS_PER_BLOCK = 256  # 1 kB, beside the 16 kB of a block's samples
_GROUP_BITS = 6  # the box is chosen among groups of 64^3 blocks


class Lookup(NamedTuple):
    """A block index as arrays, the arguments of compiled loops.

    volume, origin   ids (X, Y, Z) int32 of the blocks of the box from origin (3,) int64, -1 where there is none
    far              (K, 2) int64: keys, sorted, and ids of the blocks outside the box; None where there are none: the
                     loops are then compiled without the search, which costs a ray 40 % of its time
    """

    volume: np.ndarray
    origin: np.ndarray
    far: np.ndarray | None


class BlockIndex:
    """Ids of blocks by their coordinates; id = position in the tensor of all blocks."""

    def __init__(self, device: torch.device) -> None:
        self._device = device
        self._build(torch.empty(0, 3, dtype=torch.int64, device=device), None)

    def add(self, blocks: Tensor, count: int) -> None:
        """Take in the last `count` > 0 of all `blocks` (B, 3) int64, which are new."""
        new = blocks[len(blocks) - count :]
        low, high = new.amin(0), new.amax(0) + 1
        if len(blocks) > count and bool(((low >= self._origin) & (high <= self._origin + self._shape)).all()):
            x, y, z = (new - self._origin).unbind(-1)
            ids = torch.arange(len(blocks) - count, len(blocks), dtype=torch.int32, device=self._device)
            self._volume[x, y, z] = ids
            return
        if len(blocks) > count:
            low, high = torch.minimum(low, self._origin), torch.maximum(high, self._origin + self._shape)
        most = max(_MIN_CELLS, _CELLS_PER_BLOCK * len(blocks))
        box = torch.stack([low - _MARGIN, high + _MARGIN])
        self._build(blocks, box if _cells(box) <= most else _dense_box(blocks, most))

    def find(self, blocks: Tensor) -> Tensor:
        """(..., 3) int64 block coordinates -> (...) int64 ids, -1 where there is no block."""
        shape = self._shape
        local = blocks - self._origin
        inside = ((local >= 0) & (local < shape)).all(-1)
        local = torch.where(inside[..., None], local, 0)
        flat = (local[..., 0] * shape[1] + local[..., 1]) * shape[2] + local[..., 2]
        ids = torch.where(inside, self._volume.view(-1)[flat].long(), -1)
        if not len(self._far):
            return ids
        keys, far_keys = pack(blocks), self._far[:, 0].contiguous()
        place = torch.searchsorted(far_keys, keys).clamp(max=len(far_keys) - 1)
        is_there = (far_keys[place] == keys) & in_range(blocks) & ~inside
        return torch.where(is_there, self._far[place, 1], ids)

    def lookup(self) -> Lookup:
        """The arrays for compiled loops, on the CPU."""
        far = self._far.cpu().numpy() if len(self._far) else None
        return Lookup(self._volume.cpu().numpy(), self._origin.cpu().numpy(), far)

    def extent(self) -> tuple[Tensor, Tensor]:
        """Lowest coordinates (3,) and extent (3,) int64 of a box that holds all blocks."""
        return self._low, self._extent

    def _build(self, blocks: Tensor, box: Tensor | None) -> None:
        """Index all `blocks` anew, with the dense array over `box` (2, 3), low and high; None: of one cell."""
        if box is None:
            box = torch.tensor([[0, 0, 0], [1, 1, 1]], device=self._device)
        self._origin, self._shape = box[0], box[1] - box[0]  # tensors: no lookup waits for the device
        self._volume = torch.full(tuple(self._shape.tolist()), -1, dtype=torch.int32, device=self._device)
        ids = torch.arange(len(blocks), dtype=torch.int32, device=self._device)
        inside = ((blocks >= box[0]) & (blocks < box[1])).all(-1)
        x, y, z = (blocks[inside] - self._origin).unbind(-1)
        self._volume[x, y, z] = ids[inside]
        far = blocks[~inside]
        keys, order = pack(far).sort()
        self._far = torch.stack([keys, ids[~inside][order].long()], 1)
        ends = torch.cat([box, far, far + 1])
        self._low = ends.amin(0)
        self._extent = ends.amax(0) - self._low


def pack(blocks: Tensor) -> Tensor:
    """(..., 3) int64 coordinates within `RANGE` -> (...) int64 keys, in the order of x, y, z."""
    x, y, z = (blocks + RANGE).unbind(-1)
    return (x << (2 * _BITS)) | (y << _BITS) | z


def unpack(keys: Tensor) -> Tensor:
    """The inverse of `pack`."""
    return torch.stack([keys >> (2 * _BITS), (keys >> _BITS) & _MASK, keys & _MASK], -1) - RANGE


def in_range(blocks: Tensor) -> Tensor:
    """(..., 3) coordinates -> (...) whether `pack` can tell them from all others."""
    return ((blocks >= -RANGE) & (blocks < RANGE)).all(-1)


@compiled()
def block_of(i: Index, j: Index, k: Index, volume: np.ndarray, origin: np.ndarray, far: np.ndarray | None) -> Index:
    """`BlockIndex.find` of one block, for compiled loops; the arrays are those of `Lookup`."""
    a, b, c = i - origin[0], j - origin[1], k - origin[2]
    if a < 0 or b < 0 or c < 0 or a >= volume.shape[0] or b >= volume.shape[1] or c >= volume.shape[2]:
        if far is None:
            return -1
        return _search(i, j, k, far)
    return np.int64(volume[a, b, c])


@compiled()
def _search(i: Index, j: Index, k: Index, far: np.ndarray) -> Index:
    i, j, k = i + RANGE, j + RANGE, k + RANGE
    if i < 0 or j < 0 or k < 0 or i > _MASK or j > _MASK or k > _MASK:
        return -1
    key = (i << (2 * _BITS)) | (j << _BITS) | k
    first, last = 0, len(far)
    while first < last:
        middle = (first + last) // 2
        if far[middle, 0] < key:
            first = middle + 1
        else:
            last = middle
    return far[first, 1] if first < len(far) and far[first, 0] == key else -1


def _cells(box: Tensor) -> int:
    x, y, z = (box[1] - box[0]).tolist()
    return int(x * y * z)


def _dense_box(blocks: Tensor, most: int) -> Tensor:
    """A box (2, 3) of at most `most` cells around the place with the most blocks, with as many others as fit.

    Groups of blocks join from near to far. The box of one group and its margin always fits.
    """
    keys, counts = torch.unique(pack(blocks >> _GROUP_BITS), return_counts=True)
    groups, side = unpack(keys), 1 << _GROUP_BITS
    boxes = torch.stack([groups * side - _MARGIN, (groups + 1) * side + _MARGIN], 1)
    distance = (groups - groups[counts.argmax()]).abs().amax(-1)
    order = distance.argsort(stable=True)
    box = boxes[order[0]]
    for around in boxes[order[1:]]:
        union = torch.stack([torch.minimum(box[0], around[0]), torch.maximum(box[1], around[1])])
        if _cells(union) <= most:
            box = union
    return box
