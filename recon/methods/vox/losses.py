"""The loss of mapping and tracking; docs/baselines.md, `vox-fusion`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.config.vox import VoxConfig
from .rendering import Rendered
from .sampling import Samples


@dataclass(frozen=True)
class Targets:
    """Colour and depth measured on N rays; all measurements have the same weight.

    colors   (N, 3) in 0..1
    depths   (N, K) metres by sensor
    valid    (N, K) bool, whether the measurement takes part in the loss
    """

    colors: Tensor
    depths: Tensor
    valid: Tensor

    def __getitem__(self, rays: int | slice) -> Targets:
        """Those of some rays; of one step, where a leading dimension counts steps."""
        return Targets(self.colors[rays], self.depths[rays], self.valid[rays])


@dataclass(frozen=True)
class Counts:
    """Numbers of a batch, int64 scalars: with them its loss can be computed as a sum over parts of the batch.

    rays           with a measurement
    measurements   of all sensors
    free           pairs of a sample in free space and a measurement
    near           pairs of a sample within the truncation and a measurement
    """

    rays: Tensor
    measurements: Tensor
    free: Tensor
    near: Tensor

    @staticmethod
    def of(samples: Samples, targets: Targets, truncation_m: float) -> Counts:
        """Count them in the rays of a batch; scalars of int64."""
        zones = [_zones(samples, targets, sensor, truncation_m) for sensor in range(targets.depths.shape[1])]
        free, near = (torch.stack([zone[part].sum() for zone in zones]).sum() for part in (0, 1))
        return Counts(targets.valid.any(1).sum(), targets.valid.sum(), free, near)


def vox_loss(rendered: Rendered, samples: Samples, targets: Targets, counts: Counts, config: VoxConfig) -> Tensor:
    """The part that these rays have in the loss of the batch that `counts` describes.

    Means of |I - I-hat| over rays and channels, of |D - D-hat| over measurements, and over all pairs of a sample and a
    measurement: of (s - 1)^2 in free space, more than t before the measurement, and of (z + t s - D)^2, square
    metres, within t of it. Each of these two is multiplied by the share of pairs of the other, to balance the numbers.
    """
    t, seen = config.truncation_m, targets.valid.any(1)
    color = ((rendered.color - targets.colors).abs().sum(1) * seen).sum() / (3 * counts.rays).clamp(min=1)
    depth = rendered.depth.new_zeros(())
    free, near = rendered.depth.new_zeros(()), rendered.depth.new_zeros(())
    for sensor in range(targets.depths.shape[1]):
        reading = targets.depths[:, sensor]
        depth = depth + ((rendered.depth - reading).abs() * targets.valid[:, sensor]).sum()
        in_free, in_near = _zones(samples, targets, sensor, t)
        free = free + ((rendered.sdf - 1).square() * in_free).sum()
        near = near + ((samples.z + t * rendered.sdf - reading[:, None]).square() * in_near).sum()
    pairs = (counts.free + counts.near).clamp(min=1).float()
    free = free / pairs * (counts.near / pairs)
    near = near / pairs * (counts.free / pairs)
    depth = depth / counts.measurements.clamp(min=1)
    return config.color_weight * color + config.depth_weight * depth + config.free_weight * free + (
        config.sdf_weight * near
    )  # fmt: skip


def without_outliers(targets: Targets, depth: Tensor, medians: float) -> Targets:
    """Without measurements (N, K) that differ from the rendered depth (N,) by `medians` times the median or more."""
    error = (targets.depths - depth[:, None]).abs()
    middle = torch.where(targets.valid, error, torch.nan).nanmedian()
    return Targets(targets.colors, targets.depths, targets.valid & (error < medians * middle))


def _zones(samples: Samples, targets: Targets, sensor: int, truncation_m: float) -> tuple[Tensor, Tensor]:
    """(N, S) bool each: samples in the free space before the sensor's measurement, and samples near it."""
    reading = targets.depths[:, sensor, None]
    counted = samples.there & targets.valid[:, sensor, None]
    free = samples.z < reading - truncation_m
    return counted & free, counted & ~free & (samples.z <= reading + truncation_m)
