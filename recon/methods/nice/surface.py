"""The scene's surface as the sparse field that meshes, scores and pictures are made from.

Logits are sampled at the voxel size; the surface is their level 0 (docs/uncle-paper.md, Surface). Samples that no
camera observed are unknown.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.map_config import MapConfig
from ...volume.neural_field import ACTIVE_VOXELS, NeuralField
from ...volume.sparse_grid import BLOCK, ROWS, SparseGrid, unique_blocks
from .objective import Evaluate
from .scene import GridScene

_BLOCKS_AT_A_TIME = 256
_VISIBLE_BLOCKS_AT_A_TIME = 2048
_ROWS_AT_A_TIME = 1 << 17


@dataclass(frozen=True)
class SurfaceParameters:
    """behind_m: samples so far behind a depth count as observed, as the surface may lie there; near_voxels: distances
    are clipped to so many voxels; outside_logit: of samples outside of the box, free space; max_frames: used to find
    what was observed."""

    behind_m: float = 0.3
    near_voxels: float = 4.0
    outside_logit: float = -1.0
    max_frames: int = 150


PARAMETERS = SurfaceParameters()


class ObservedSamples:
    """The samples of a grid over a box, and which of them the cameras observed."""

    def __init__(
        self, grid: SparseGrid, bound: Tensor, camera: Camera, parameters: SurfaceParameters = PARAMETERS
    ) -> None:
        self.grid, self.camera, self.parameters = grid, camera, parameters
        low = torch.floor(bound[0].cpu() / grid.block_size_m).long()
        high = torch.ceil(bound[1].cpu() / grid.block_size_m).long()
        axes = [torch.arange(int(a), int(b)) for a, b in zip(low, high, strict=True)]
        grid.allocate(torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).view(-1, 3).to(grid.device))
        self.bound = bound
        self.observed = torch.zeros(grid.rows, dtype=torch.bool, device=grid.device)

    def add(self, depths: Tensor, T_world_camera: Tensor) -> None:
        """Mark the samples before a depth, or a little behind it, in images (K, H, W) metres from a pose (4, 4)."""
        half = 0.5 * self.grid.block_size_m
        centres = (self.grid.blocks + 0.5) * self.grid.block_size_m
        local = (centres - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
        u, v, z = self.camera.project(local)
        slack = 2 * half * max(self.camera.fx, self.camera.fy) / z.clamp(min=half)
        near = (u > -slack) & (u < self.camera.width + slack) & (v > -slack) & (v < self.camera.height + slack)
        farthest = float(depths.max()) + self.parameters.behind_m + 2 * half
        near &= (z > -2 * half) & (z < farthest) | (local.norm(dim=-1) < 4 * half)
        for ids in near.nonzero()[:, 0].split(_VISIBLE_BLOCKS_AT_A_TIME):
            self._mark(ids, depths, T_world_camera)

    def _mark(self, ids: Tensor, depths: Tensor, T_world_camera: Tensor) -> None:
        points = self.grid.block_positions(ids).view(-1, 3)
        u, v, z = self.camera.project((points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3])
        column, row = u.round().long(), v.round().long()
        inside = (column >= 0) & (column < self.camera.width) & (row >= 0) & (row < self.camera.height)
        pixel = torch.where(inside, row * self.camera.width + column, 0)
        farthest = depths.flatten(1)[:, pixel].amax(0)  # of the sensors
        visible = inside & (farthest > 0) & (z < farthest + self.parameters.behind_m)
        rows = (ids[:, None] * ROWS + torch.arange(ROWS, device=ids.device)).view(-1)
        self.observed[rows] |= visible


@torch.no_grad()
def extract_field(scene: GridScene, samples: ObservedSamples, evaluate: Evaluate, config: MapConfig) -> NeuralField:
    """Signed distances from the logits, divided by one slope for the whole scene so that the level 0 does not move."""
    voxel, parameters = samples.grid.voxel_size_m, samples.parameters
    ids = samples.observed.view(-1, ROWS).any(1).nonzero()[:, 0]
    parts = [_logits(scene, samples, part, evaluate) for part in ids.split(_BLOCKS_AT_A_TIME)]
    logits = torch.cat(parts or [torch.zeros(0, ROWS, device=scene.device)])
    known = samples.observed.view(-1, ROWS)[ids]
    slope = _slope(logits, known) / voxel
    limit = parameters.near_voxels * voxel
    sdf = (-logits / slope).clamp(-limit, limit)
    chosen = _with_neighbours((known & (sdf.abs() < limit)).any(1), samples.grid.blocks[ids])
    grid = SparseGrid(voxel, scene.device)
    grid.restore(samples.grid.blocks[ids][chosen])
    sdf, known = sdf[chosen].view(-1), known[chosen].view(-1)
    base = torch.cat([sdf[:, None], _colors(scene, grid, sdf, known)], 1)
    sigma = torch.full_like(sdf, config.fusion.truncation_voxels * voxel)  # the method states no error of the surface
    return NeuralField(grid, base, sigma, known, config.field, torch.Generator())


def _logits(scene: GridScene, samples: ObservedSamples, ids: Tensor, evaluate: Evaluate) -> Tensor:
    """(M,) blocks -> (M, 512)."""
    points = samples.grid.block_positions(ids).view(-1, 3)
    inside = ((points >= scene.bound[0]) & (points <= scene.bound[1])).all(1)
    logits = evaluate(points[:, None], "fine").logits[:, 0]
    return torch.where(inside, logits, samples.parameters.outside_logit).view(-1, ROWS)


def _slope(logits: Tensor, known: Tensor) -> Tensor:
    """Median change of the logit from one sample to the next across the surface."""
    cubes, whole = logits.view(-1, BLOCK, BLOCK, BLOCK), known.view(-1, BLOCK, BLOCK, BLOCK)
    steps = []
    for axis in (1, 2, 3):
        a, b = cubes.narrow(axis, 0, BLOCK - 1), cubes.narrow(axis, 1, BLOCK - 1)
        crossing = (a * b < 0) & whole.narrow(axis, 0, BLOCK - 1) & whole.narrow(axis, 1, BLOCK - 1)
        steps.append((a - b)[crossing].abs())
    changes = torch.cat(steps)
    return changes.median() if len(changes) else torch.ones((), device=logits.device)


def _with_neighbours(chosen: Tensor, blocks: Tensor) -> Tensor:
    """(M,) bool: blocks (M, 3) that are chosen (M,), or next to one that is."""
    steps = torch.tensor([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)], device=blocks.device)
    table = SparseGrid(1.0, blocks.device)
    table.restore(unique_blocks((blocks[chosen][:, None] + steps).view(-1, 3)))
    return table.block_ids(blocks) >= 0


def _colors(scene: GridScene, grid: SparseGrid, sdf: Tensor, known: Tensor) -> Tensor:
    """(R, 3) colours of the samples around the surface, grey elsewhere and where none is mapped."""
    colors = torch.full((len(sdf), 3), 0.5, device=sdf.device)
    if not scene.config.color:
        return colors
    near = (known & (sdf.abs() < (ACTIVE_VOXELS + 0.5) * grid.voxel_size_m)).nonzero()[:, 0]
    inner = grid.inner_offsets()
    for rows in near.split(_ROWS_AT_A_TIME):
        points = grid.blocks[rows // ROWS] * grid.block_size_m + inner[rows % ROWS]
        colors[rows] = scene.colors(points).clamp(0, 1)
    return colors
