"""The finished map as the field that meshes, scores and pictures are made of."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.uncle import FieldConfig
from ...core.events import OnEvent, ignore, track_progress
from ...volume.neural_field import ACTIVE_VOXELS, NeuralField
from ...volume.sparse_grid import ROWS, SparseGrid
from .model import VoxModel

MAX_VIEWS = 60  # images that decide which samples were observed
_BLOCKS_AT_A_TIME = 512
_POINTS_AT_A_TIME = 1 << 14


class SampledSurface:
    """A grid over the voxels of a model, and how many images saw each of its samples within them."""

    def __init__(self, model: VoxModel, camera: Camera, voxel_size_m: float) -> None:
        self.model, self.camera = model, camera
        self.grid = _grid_over(model, voxel_size_m)
        self.voxels = torch.full((self.grid.rows,), -1, dtype=torch.int64, device=model.device)  # each sample's own
        self.counts = torch.zeros(self.grid.rows, dtype=torch.int16, device=model.device)
        for ids in self._parts(torch.arange(len(self.grid.blocks), device=model.device)):
            points = self.grid.block_positions(ids).view(-1, 3)
            self.voxels[_rows_of(ids)] = model.voxels.containing(points)

    @torch.no_grad()
    def count_view(self, depths: Tensor, T_world_camera: Tensor) -> None:
        """Count the samples that an image observed: depths (P, K) metres by sensor, 0 = none; T_world_camera (4, 4).

        Observed is what lies before the farthest depth of its pixel or at most a truncation behind it.
        """
        farthest, camera = depths.amax(1), self.camera
        for ids in self._parts(self._in_view(T_world_camera)):
            points = self.grid.block_positions(ids).view(-1, 3)
            u, v, z = camera.project((points - T_world_camera[:3, 3]) @ T_world_camera[:3, :3])
            u, v = u.round().long(), v.round().long()
            inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
            reading = farthest[torch.where(inside, v * camera.width + u, 0)]
            seen = inside & (reading > 0) & (z <= reading + self.model.config.truncation_m)
            self.counts[_rows_of(ids)] += seen

    @torch.no_grad()
    def field(self, least: int, config: FieldConfig, on_event: OnEvent = ignore) -> NeuralField:
        """The model where at least `least` images observed it; colour near the surface, grey elsewhere.

        Sigma is one truncation everywhere: the method does not estimate errors.
        """
        model, device = self.model, self.model.device
        known = (self.voxels >= 0) & (self.counts >= least)
        base = torch.tensor([0.0, 0.5, 0.5, 0.5], device=device).repeat(self.grid.rows, 1)
        near = ACTIVE_VOXELS * self.grid.voxel_size_m
        parts = known.nonzero()[:, 0].split(_POINTS_AT_A_TIME)
        for rows in track_progress(parts, len(parts), "sampling the surface", on_event, "parts"):
            hidden = model.decoder.trunk(model.embed(self._positions(rows), self.voxels[rows]))
            sdf = model.decoder.distance(hidden) * model.config.truncation_m
            base[rows, 0] = sdf
            close = (sdf.abs() < near).nonzero()[:, 0]
            base[rows[close], 1:] = model.decoder.color(hidden[close])
        sigma = torch.full_like(base[:, 0], model.config.truncation_m)
        plain = config.model_copy(update={"levels": ()})
        return NeuralField(self.grid, base, sigma, known, plain, torch.Generator())

    def _parts(self, ids: Tensor) -> tuple[Tensor, ...]:
        return ids.split(_BLOCKS_AT_A_TIME)

    def _positions(self, rows: Tensor) -> Tensor:
        """World positions (N, 3) of samples."""
        return self.grid.blocks[rows // ROWS] * self.grid.block_size_m + self.grid.inner_offsets()[rows % ROWS]

    def _in_view(self, T_world_camera: Tensor) -> Tensor:
        """Ids of the blocks that may be in the image."""
        side, camera = self.grid.block_size_m, self.camera
        local = ((self.grid.blocks + 0.5) * side - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
        u, v, z = camera.project(local)
        margin = side * max(camera.fx, camera.fy) / z.clamp(min=side)
        across = (u > -margin) & (u < camera.width + margin) & (v > -margin) & (v < camera.height + margin)
        return ((local.norm(dim=1) < 2 * side) | (z > 0) & across).nonzero()[:, 0]


def _rows_of(ids: Tensor) -> Tensor:
    """(M,) block ids -> (M * 512,) rows."""
    return (ids[:, None] * ROWS + torch.arange(ROWS, device=ids.device)).view(-1)


def _grid_over(model: VoxModel, voxel_size_m: float) -> SparseGrid:
    """Blocks with samples in the voxels or on their faces."""
    grid, size = SparseGrid(voxel_size_m, model.device), model.voxels.size_m
    pieces = math.ceil(size / grid.block_size_m)
    steps = torch.linspace(0, 1, pieces + 1, device=model.device)
    corners = torch.cartesian_prod(steps, steps, steps)
    for part in model.voxels.voxels.blocks.split(4096):
        points = ((part[:, None, :] + corners) * size).view(-1, 3)
        grid.allocate(torch.floor(points / grid.block_size_m + 1e-6).long())
    return grid
