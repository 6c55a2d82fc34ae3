"""Iso-surface of a sparse grid, tile by tile, so that memory follows the surface and not the bounding box."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from skimage.measure import marching_cubes
from torch import Tensor

from ..core.events import OnEvent, ignore, track_progress
from ..core.row_keys import row_keys
from .sparse_grid import BLOCK, SparseGrid, unique_blocks

TILE_BLOCKS = 8  # a tile is 64^3 cells: 1 MB of float32, and large enough that calls do not dominate
_SIDE = TILE_BLOCKS * BLOCK

# (M,) block ids -> sdf (M, 512) metres and known (M, 512) bool, in row order
BlockSamples = Callable[[Tensor], tuple[Tensor, Tensor]]


def extract_isosurface(
    grid: SparseGrid, samples: BlockSamples, on_event: OnEvent = ignore
) -> tuple[np.ndarray, np.ndarray]:
    """Marching cubes over the allocated blocks.

    Returns vertices (V, 3) float32 metres and faces (F, 3) int32 whose normals point into free space. A cell takes
    part only if its eight corners are known: the surface ends where nothing was observed, it is never closed by a wall.
    """
    tiles = unique_blocks(torch.div(grid.blocks, TILE_BLOCKS, rounding_mode="floor"))
    parts, count = [], 0
    for tile in track_progress(tiles, len(tiles), "extracting the surface", on_event, "tiles"):
        vertices, faces = _tile_surface(*_dense_tile(grid, tile, samples))
        if len(faces):
            parts.append((vertices + tile.cpu().numpy() * _SIDE, faces + count))
            count += len(vertices)
    if not parts:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)
    vertices, faces = _weld(np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts]))
    return (vertices * grid.voxel_size_m).astype(np.float32), faces.astype(np.int32)


def _dense_tile(grid: SparseGrid, tile: Tensor, samples: BlockSamples) -> tuple[np.ndarray, np.ndarray]:
    """sdf and known, (65, 65, 65), of one tile and the first layer of its upper neighbours."""
    side = TILE_BLOCKS + 1
    steps = torch.arange(side, device=grid.device)
    local = torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"), -1).view(-1, 3)
    ids = grid.block_ids(tile * TILE_BLOCKS + local)
    present = ids >= 0
    x, y, z = local[present].unbind(-1)
    dense = []
    for values in samples(ids[present]):
        array = values.new_zeros(side, BLOCK, side, BLOCK, side, BLOCK)
        array[x, :, y, :, z, :] = values.view(-1, BLOCK, BLOCK, BLOCK)
        dense.append(array.view((side * BLOCK,) * 3)[(slice(0, _SIDE + 1),) * 3].cpu().numpy())
    return dense[0], dense[1]


def _tile_surface(sdf: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, in voxels from the tile's corner, and faces of the cells whose corners are all known."""
    cells = np.ones((_SIDE,) * 3, dtype=bool)
    for x, y, z in np.ndindex(2, 2, 2):
        cells &= known[x : x + _SIDE, y : y + _SIDE, z : z + _SIDE]
    filled = np.where(known, sdf, 1.0)
    if not cells.any() or filled.min() > 0 or filled.max() <= 0:  # a 0 beside a positive value is a surface
        return np.zeros((0, 3)), np.zeros((0, 3), np.int64)
    vertices, faces, _, _ = marching_cubes(filled, 0.0, gradient_direction="descent")
    x, y, z = np.clip(np.floor(vertices[faces].mean(1)).astype(int), 0, _SIDE - 1).T
    used, faces = np.unique(faces[cells[x, y, z]], return_inverse=True)
    return vertices[used].astype(np.float64), faces.reshape(-1, 3)


def _weld(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge the vertices that neighbouring tiles share (equal to 1e-3 voxel) and drop faces that collapse."""
    keys = row_keys(np.round(vertices * 1024).astype(np.int64))
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    faces = inverse.reshape(-1)[faces]
    a, b, c = faces.T
    return vertices[first], faces[(a != b) & (b != c) & (c != a)]
