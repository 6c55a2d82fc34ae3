"""The scene's surface as the sparse field that meshes, scores and pictures are made from.

Logits are sampled at the voxel size; the surface is where they are 0 (METHOD, Meshing). The published code closes the
space that nobody saw with solid logits and cuts the walls that this makes away later; here such samples are unknown.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.map_config import MapConfig
from ...volume.neural_field import ACTIVE_VOXELS, NeuralField
from ...volume.sparse_grid import BLOCK, ROWS, SparseGrid, unique_blocks
from .objective import Evaluate
from .scene import Scene

BEHIND_M = 0.3  # samples so far behind a reading are still known: as far as its surface can lie behind it
NEAR_VOXELS = 4.0  # distances are cut off at
_BLOCKS_AT_A_TIME = 256


class Seen:
    """Which blocks of samples the cameras looked at, and which of their samples."""

    def __init__(self, grid: SparseGrid, bound: Tensor, camera: Camera) -> None:
        self.grid, self.camera = grid, camera
        low = torch.floor(bound[0].cpu() / grid.block_size_m).long()
        high = torch.ceil(bound[1].cpu() / grid.block_size_m).long()
        axes = [torch.arange(int(a), int(b)) for a, b in zip(low, high, strict=True)]
        grid.allocate(torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).view(-1, 3).to(grid.device))
        self.bound = bound
        self.known = torch.zeros(grid.rows, dtype=torch.bool, device=grid.device)

    def add(self, depths: Tensor, T_world_camera: Tensor) -> None:
        """Depth images (K, H, W) metres: all samples before a reading, or a little behind it, are known from now on."""
        half = 0.5 * self.grid.block_size_m
        centres = (self.grid.blocks + 0.5) * self.grid.block_size_m
        local = (centres - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
        u, v, z = self.camera.project(local)
        slack = 2 * half * max(self.camera.fx, self.camera.fy) / z.clamp(min=half)
        near = (u > -slack) & (u < self.camera.width + slack) & (v > -slack) & (v < self.camera.height + slack)
        near &= (z > -2 * half) & (z < float(depths.max()) + BEHIND_M + 2 * half) | (local.norm(dim=-1) < 4 * half)
        for ids in near.nonzero()[:, 0].split(2048):
            self._look(ids, depths, T_world_camera)

    def _look(self, ids: Tensor, depths: Tensor, T_world_camera: Tensor) -> None:
        points = self.grid.block_positions(ids).view(-1, 3)
        u, v, z = self.camera.project((points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3])
        column, row = u.round().long(), v.round().long()
        inside = (column >= 0) & (column < self.camera.width) & (row >= 0) & (row < self.camera.height)
        pixel = torch.where(inside, row * self.camera.width + column, 0)
        reading = depths.flatten(1)[:, pixel].amax(0)  # what any sensor reads
        seen = inside & (reading > 0) & (z < reading + BEHIND_M)
        rows = (ids[:, None] * ROWS + torch.arange(ROWS, device=ids.device)).view(-1)
        self.known[rows] |= seen


@torch.no_grad()
def field_of(scene: Scene, seen: Seen, evaluate: Evaluate, config: MapConfig) -> NeuralField:
    """The field: logits as distances, by one slope for the whole scene so that the zero level stays where it is."""
    voxel = seen.grid.voxel_size_m
    ids = seen.known.view(-1, ROWS).any(1).nonzero()[:, 0]
    logits = torch.cat([_logits(scene, seen.grid, part, evaluate) for part in ids.split(_BLOCKS_AT_A_TIME)]
                       or [torch.zeros(0, ROWS, device=scene.device)])  # fmt: skip
    known = seen.known.view(-1, ROWS)[ids]
    slope = _slope(logits, known) / voxel
    sdf = (-logits / slope).clamp(-NEAR_VOXELS * voxel, NEAR_VOXELS * voxel)
    chosen = _beside((known & (sdf.abs() < NEAR_VOXELS * voxel)).any(1), seen.grid.blocks[ids])
    grid = SparseGrid(voxel, scene.device)
    grid.restore(seen.grid.blocks[ids][chosen])
    sdf, known = sdf[chosen].view(-1), known[chosen].view(-1)
    base = torch.cat([sdf[:, None], _colors(scene, grid, sdf, known, evaluate)], 1)
    sigma = torch.full_like(sdf, config.fusion.truncation_voxels * voxel)  # the scene says nothing about its own error
    return NeuralField(grid, base, sigma, known, config.field, torch.Generator())


def _logits(scene: Scene, grid: SparseGrid, ids: Tensor, evaluate: Evaluate) -> Tensor:
    """(M,) blocks -> (M, 512)."""
    points = grid.block_positions(ids).view(-1, 3)
    inside = ((points >= scene.bound[0]) & (points <= scene.bound[1])).all(1)
    logits = evaluate(points[:, None], "fine").logits[:, 0]
    return torch.where(inside, logits, -1.0).view(-1, ROWS)  # nothing is known beyond the box; a wall there is none


def _slope(logits: Tensor, known: Tensor) -> Tensor:
    """Typical change of the logit from one sample to the next across the surface."""
    cubes, whole = logits.view(-1, BLOCK, BLOCK, BLOCK), known.view(-1, BLOCK, BLOCK, BLOCK)
    steps = []
    for axis in (1, 2, 3):
        a, b = cubes.narrow(axis, 0, BLOCK - 1), cubes.narrow(axis, 1, BLOCK - 1)
        crossing = (a * b < 0) & whole.narrow(axis, 0, BLOCK - 1) & whole.narrow(axis, 1, BLOCK - 1)
        steps.append((a - b)[crossing].abs())
    found = torch.cat(steps)
    return found.median() if len(found) else torch.ones((), device=logits.device)


def _beside(wanted: Tensor, blocks: Tensor) -> Tensor:
    """(M,) bool: blocks (M, 3) that are wanted, or next to one that is."""
    steps = torch.tensor([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], device=blocks.device)
    table = SparseGrid(1.0, blocks.device)
    table.restore(unique_blocks((blocks[wanted][:, None] + steps).view(-1, 3)))
    return table.block_ids(blocks) >= 0


def _colors(scene: Scene, grid: SparseGrid, sdf: Tensor, known: Tensor, evaluate: Evaluate) -> Tensor:
    """(R, 3) colours of the samples around the surface, grey where none is mapped."""
    colors = torch.full((len(sdf), 3), 0.5, device=sdf.device)
    if not scene.config.color:
        return colors
    near = (known & (sdf.abs() < (ACTIVE_VOXELS + 0.5) * grid.voxel_size_m)).nonzero()[:, 0]
    inner = grid.inner_offsets()
    for rows in near.split(1 << 17):
        points = grid.blocks[rows // ROWS] * grid.block_size_m + inner[rows % ROWS]
        colors[rows] = scene.colors(points).clamp(0, 1)
    return colors
