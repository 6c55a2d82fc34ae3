"""The running means of one sensor: signed distance, feature and weight of each sample of a map."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .network import FEATURES

BEHIND_VOXELS = 3
MAX_WEIGHT = 500.0
BORDER_PX = 10
FARTHEST_M = 12.3


@dataclass(frozen=True)
class RaySamples:
    """Samples on the rays of M measurements, K on each.

    voxels   (M, K, 3) int64, the samples nearest to points on the ray
    sdf      (K,) metres, positive in front of the measurement
    pixels   (M,) int64, place of each measurement in the flattened image
    """

    voxels: Tensor
    sdf: Tensor
    pixels: Tensor


def ray_samples(
    depth: Tensor,
    rays: Tensor,
    T_world_camera: Tensor,
    voxel_size_m: float,
    before: int,
    max_depth_m: float = FARTHEST_M,
) -> RaySamples:
    """Points one voxel apart on the rays of depth (H, W) metres: `before` ones before the measurement to 3 behind it.

    rays (H, W, 3) as of `Camera.rays`. Distances are along the ray. The outer 10 pixels take no part.
    """
    usable = (depth > 0) & (depth < max_depth_m)
    inside = torch.zeros_like(usable)
    inside[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX] = True
    pixels = (usable & inside).view(-1).nonzero()[:, 0]
    directions = rays.reshape(-1, 3)[pixels]
    readings = directions * depth.reshape(-1)[pixels, None]
    rotation = T_world_camera[:3, :3]
    steps = torch.arange(-before, BEHIND_VOXELS + 1, device=depth.device, dtype=depth.dtype)
    ahead = torch.nn.functional.normalize(directions, dim=-1) @ rotation.T  # voxels
    start = (readings @ rotation.T + T_world_camera[:3, 3]) / voxel_size_m
    voxels = torch.round(start[:, None] + ahead[:, None] * steps[:, None]).long()
    return RaySamples(voxels, -steps * voxel_size_m, pixels)


@dataclass(frozen=True)
class Update:
    """New values of the samples `rows` (T,): tsdf (T,) metres, weight (T,), features (T, 4)."""

    rows: Tensor
    tsdf: Tensor
    weight: Tensor
    features: Tensor


class SensorGrid:
    """tsdf (R,) metres, weight (R,) and features (R, 4), all 0 at first."""

    def __init__(self, rows: int, device: torch.device | str = "cpu") -> None:
        self.device = torch.device(device)
        self.tsdf, self.weight = torch.zeros(rows, device=device), torch.zeros(rows, device=device)
        self.features = torch.zeros(rows, FEATURES, device=device)
        self._slot = torch.zeros(rows, dtype=torch.int64, device=device)

    def grow(self, rows: int) -> None:
        """Become a grid of at least `rows` samples."""
        missing = rows - len(self.tsdf)
        if missing > 0:
            spare = missing + rows // 2
            self.tsdf, self.weight, self.features, self._slot = (
                torch.cat([table, table.new_zeros(spare, *table.shape[1:])])
                for table in (self.tsdf, self.weight, self.features, self._slot)
            )

    def with_measurements(self, rows: Tensor, sdf: Tensor, features: Tensor) -> Update:
        """The samples after M more measurements.

        rows (M, K), -1 = outside; sdf (K,) metres; features (M, 4), with gradient.

        Each sample is the mean over all its measurements, with equal weights.
        """
        flat = rows.reshape(-1)
        kept = (flat >= 0).nonzero()[:, 0]
        flat = flat[kept]
        touched, inverse = self._distinct(flat)
        owner, point = kept // rows.shape[1], kept % rows.shape[1]
        count = torch.bincount(inverse, minlength=len(touched)).float()
        sums = torch.zeros_like(count).index_add(0, inverse, sdf[point])
        feature_sums = torch.zeros(len(touched), FEATURES, device=self.device).index_add(0, inverse, features[owner])
        before = self.weight[touched]
        total = before + count
        tsdf = (before * self.tsdf[touched] + sums) / total
        mixed = (before[:, None] * self.features[touched] + feature_sums) / total[:, None]
        return Update(touched, tsdf, total.clamp(max=MAX_WEIGHT), mixed)

    def apply(self, update: Update) -> None:
        """Store it, without gradient."""
        self.tsdf[update.rows] = update.tsdf.detach()
        self.weight[update.rows] = update.weight
        self.features[update.rows] = update.features.detach()

    def clear(self) -> None:
        """Forget all measurements."""
        for table in (self.tsdf, self.weight, self.features):
            table.zero_()

    def slots(self, rows: Tensor) -> Tensor:
        """(R,) position of each sample in the distinct `rows` (T,), counted from 1; 0 = not among them."""
        slots = torch.zeros_like(self._slot)
        slots[rows] = torch.arange(1, len(rows) + 1, device=self.device)
        return slots

    def _distinct(self, rows: Tensor) -> tuple[Tensor, Tensor]:
        """The distinct values of `rows`, sorted, and the position of each row among them; quicker than `unique`."""
        self._slot[rows] = 1
        touched = self._slot.nonzero()[:, 0]
        self._slot[touched] = torch.arange(len(touched), device=self.device)
        inverse = self._slot[rows]
        self._slot[touched] = 0
        return touched, inverse
