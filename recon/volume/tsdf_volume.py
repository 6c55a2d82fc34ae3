"""Weighted fusion of depth images into signed distances: the closed-form part of the map.

Each sample keeps running sums over all its observations. With all weights 1 this is plain fusion of truncated signed
distances (Curless and Levoy 1996); with inverse variances it is the precision-weighted mean.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d

from ..core.camera import Camera
from .integration import MIN_Z_M, Bounds, Observation, integrate
from .sparse_grid import BLOCK, ROWS, SparseGrid

_TILE = 16  # pixels: occlusion is decided on tiles
_SPARE = 1.5
ERROR_CORRELATION = 0.15  # of two observations of one place; of the pixels of one sensor mostly
MIN_SIGMA_M = 1e-3
MAX_SIGMA_M = 1.0  # of samples with almost no weight: such a corner must not decide the sigma of a vertex
ALL = slice(None)


@dataclass(frozen=True)
class FreeSpace:
    """Weights of an image for the space in front of its surface: weight (H, W) and scale_m (H, W) metres.

    A sample at the distance d in front of the truncation band gets weight * (1 - exp(-d / scale_m)): the farther from
    the surface, on the scale of the measurement's noise, the more certain it is free.
    """

    weight: Tensor
    scale_m: Tensor

    @staticmethod
    def from_weight(weight: Tensor, median: float, scale_m: Tensor) -> FreeSpace:
        """Free-space weights from those of the surface: their geometric mean with the `median` one of the image.

        Also a noisy measurement shows that the ray was free.
        """
        return FreeSpace((weight * median).sqrt(), scale_m)


@dataclass(frozen=True)
class Samples:
    """sums (..., 4) and color_sums (..., 4) of some samples of the map (see `TsdfVolume`), and their statistics."""

    sums: Tensor
    color_sums: Tensor

    @property
    def sdf(self) -> Tensor:
        """(...) mean signed distance in metres, 0 where there is no observation."""
        return _mean_sdf(self.sums)

    @property
    def spread(self) -> Tensor:
        """(...) weighted standard deviation of the observed distances, metres."""
        mean_square = self.sums[..., 2] / self.sums[..., 0].clamp(min=1e-12)
        return (mean_square - self.sdf**2).clamp(min=0).sqrt()

    @property
    def sigma(self) -> Tensor:
        """(...) standard error of the mean distance, metres, from the spread of the observations.

        Errors of observations of one place are correlated (same sensor, same texture), so the variance of the mean
        falls with their number to `ERROR_CORRELATION` of a single one's at best; never below `MIN_SIGMA_M`.
        """
        gain = ERROR_CORRELATION + (1 - ERROR_CORRELATION) / self.sums[..., 3].clamp(min=1)
        return (self.spread.square() * gain).sqrt().clamp(min=MIN_SIGMA_M)

    def propagated_sigma(self, weight_scale_m: float) -> Tensor:
        """(...) standard error of the mean distance, metres, propagated from the weights.

        Weights are `weight_scale_m`^2 / (beta^2 + discretisation^2), times the reliability of the sensor
        (`FusionWeights`). A Laplace distribution has the variance 2 beta^2; the mean of independent observations has
        that over the sum of the weights. To it is added the correlated part of their spread, which does not average
        out.
        """
        independent = 2 * weight_scale_m**2 / self.sums[..., 0].clamp(min=1e-12)
        return (independent + ERROR_CORRELATION * self.spread.square()).sqrt().clamp(MIN_SIGMA_M, MAX_SIGMA_M)

    @property
    def colors(self) -> Tensor:
        """(..., 3) mean colour, 0..1; grey where there is none."""
        weight = self.color_sums[..., :1]
        return torch.where(weight > 0, self.color_sums[..., 1:] / weight.clamp(min=1e-12) / 255, 0.5)


class TsdfVolume:
    """Running sums on a sparse grid.

    sums (R, 4): weight, weight * sdf, weight * sdf^2, number of observations; color_sums (R, 4): weight, weight * rgb.
    `truncation_m` bounds the distances; measurements beyond `max_depth_m` are ignored.
    """

    def __init__(self, grid: SparseGrid, camera: Camera, truncation_m: float, max_depth_m: float) -> None:
        self.grid, self.camera = grid, camera
        self.truncation_m, self.max_depth_m = float(truncation_m), float(max_depth_m)
        self.sums = torch.zeros(0, 4, device=grid.device)
        self.color_sums = torch.zeros(0, 4, device=grid.device)
        self._rays = camera.rays(grid.device)

    @property
    def ray_far_m(self) -> float:
        """How far along a ray the fused surface can lie (with slack for slanted rays and noise), metres of z-depth."""
        return 1.2 * self.max_depth_m

    @property
    def ray_step_m(self) -> float:
        """Step along a ray that cannot jump over the truncation band, metres."""
        return 0.75 * self.truncation_m

    def allocate(self, depth: Tensor, T_world_camera: Tensor) -> None:
        """Allocate blocks in the band of +- truncation around each measurement of `depth` (H, W) metres."""
        stride = max(1, int(0.5 * self.grid.block_size_m * self.camera.fx / self.max_depth_m))
        z = depth[::stride, ::stride]
        valid = (z > 0) & (z < self.max_depth_m)
        directions, z = self._rays[::stride, ::stride][valid], z[valid]
        offsets = torch.linspace(-1, 1, 5, device=z.device) * self.truncation_m
        points = directions[:, None] * (z[:, None] + offsets)[..., None]
        points = points.view(-1, 3) @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        self.grid.allocate(torch.floor(points / self.grid.block_size_m).long())
        self._grow()

    def reset(self) -> None:
        """Clear all observations, keep the blocks."""
        self.sums.zero_()
        self.color_sums.zero_()
        self._grow()

    def integrate(
        self,
        depth: Tensor,
        weight: Tensor | None,
        color: Tensor | None,
        T_world_camera: Tensor,
        free_space: FreeSpace | None = None,
    ) -> None:
        """Add one depth image: depth (H, W) metres, weight (H, W) or None = 1, color (H, W, 3) uint8 or None.

        All allocated blocks in view are updated, so that the free space in front of the surface is observed, too: with
        the weight of the measurement, or with that of `free_space`.
        """
        self._accumulate(depth, weight, color, T_world_camera, free_space, len(self.grid.blocks), 1.0)

    def deintegrate(
        self,
        depth: Tensor,
        weight: Tensor | None,
        color: Tensor | None,
        T_world_camera: Tensor,
        free_space: FreeSpace | None,
        block_count: int,
    ) -> None:
        """Subtract a depth image that was added by `integrate` with the same arguments, when there were `block_count`
        blocks."""
        self._accumulate(depth, weight, color, T_world_camera, free_space, block_count, -1.0)

    def _accumulate(
        self,
        depth: Tensor,
        weight: Tensor | None,
        color: Tensor | None,
        T_world_camera: Tensor,
        free_space: FreeSpace | None,
        block_count: int,
        sign: float,
    ) -> None:
        T_camera_world = torch.linalg.inv(T_world_camera.double()).float()
        visible = self._visible(depth, T_camera_world)
        if block_count < len(self.grid.blocks):
            visible = visible[visible < block_count]
        free_space = None if weight is None else free_space
        image = Observation(
            depth, weight, None if free_space is None else free_space.weight,
            None if free_space is None else free_space.scale_m, color, T_camera_world,
        )  # fmt: skip
        integrate(
            self.sums, self.color_sums, visible, self.grid.blocks[visible].float() * self.grid.block_size_m,
            self.grid.inner_offsets(), image, self.camera, Bounds(self.truncation_m, self.max_depth_m), sign,
        )  # fmt: skip

    def clear_empty(self) -> None:
        """Set samples whose observations were all de-integrated to exactly 0, without rounding errors."""
        empty = self.sums[:, 3] < 0.5
        self.sums[empty] = 0.0
        self.color_sums[empty] = 0.0

    def samples(self, rows: Tensor | slice = ALL) -> Samples:
        """Statistics of all samples, or of some `rows` (...)."""
        return Samples(self.sums[rows], self.color_sums[rows])

    def sdf(self) -> Tensor:
        """(R,) mean signed distance in metres, 0 where there is no observation."""
        return _mean_sdf(self.sums)

    def counts(self) -> Tensor:
        """(R,) number of observations of each sample."""
        return self.sums[:, 3]

    def _grow(self) -> None:
        missing = self.grid.rows - len(self.sums)
        if missing > 0:
            self.sums = _extended(self.sums, self.grid.rows)
            self.color_sums = _extended(self.color_sums, self.grid.rows)

    def _visible(self, depth: Tensor, T_camera_world: Tensor) -> Tensor:
        """Ids of the blocks that are in view and not wholly hidden by the surface of the image."""
        half = 0.5 * (BLOCK - 1) * self.grid.voxel_size_m
        radius = half * 3**0.5
        centres = self.grid.blocks.float() * self.grid.block_size_m + half
        u, v, z = self.camera.project(centres @ T_camera_world[:3, :3].T + T_camera_world[:3, 3])
        reach = radius * self.camera.max_focal_px / z.clamp(min=MIN_Z_M)
        seen = (u > -reach) & (u < self.camera.width + reach) & (v > -reach) & (v < self.camera.height + reach)
        seen &= (z > -radius) & (z < self.max_depth_m + self.truncation_m + radius)
        usable = torch.where(depth < self.max_depth_m, depth, 0.0)[None, None]
        farthest = max_pool2d(usable, _TILE, _TILE, ceil_mode=True)
        farthest = max_pool2d(farthest, 5, 1, 2)[0, 0]
        tile_u = (u / _TILE).long().clamp(0, farthest.shape[1] - 1)
        tile_v = (v / _TILE).long().clamp(0, farthest.shape[0] - 1)
        seen &= (reach > 2 * _TILE) | (z - radius < farthest[tile_v, tile_u] + self.truncation_m)
        return seen.nonzero()[:, 0]


def _mean_sdf(sums: Tensor) -> Tensor:
    mean: Tensor = sums[..., 1] / sums[..., 0].clamp(min=1e-12)
    return mean


def _extended(rows: Tensor, count: int) -> Tensor:
    """`rows` (R, C) with zeros appended up to `count`; takes spare room with each copy, so that copies are few."""
    spare = rows.untyped_storage().nbytes() // (rows.element_size() * rows.shape[1])
    if spare >= count:
        return rows.new_empty(0).set_(rows.untyped_storage(), 0, (count, rows.shape[1]), (rows.shape[1], 1))
    room = rows.new_zeros(int(count * _SPARE) + ROWS, rows.shape[1])
    room[: len(rows)] = rows
    return room[:count]
