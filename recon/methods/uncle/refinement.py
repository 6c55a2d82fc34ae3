"""Refinement of the neural field by its rendering likelihood, with the learned error scales and sensor reliability."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.adam import Adam
from ...core.config.map_config import MapConfig
from ...core.config.uncle import FieldConfig
from ...core.events import OnEvent, ignore, track_progress
from ...sensors.fusion_weights import WEIGHT_SCALE_M
from ...sensors.likelihood import laplace_nll
from ...volume.neural_field import NeuralField
from ...volume.raycast import cast_rays
from ...volume.rendering import render_depth, render_values, sdf_weights
from ...volume.tsdf_volume import TsdfVolume
from .ray_batch import RayBatch


@dataclass(frozen=True)
class RenderedRays:
    """depth (N,) metres, color (N, 3) in 0..1, known (N,) bool: the ray crosses known samples."""

    depth: Tensor
    color: Tensor
    known: Tensor


def surface_depths(field: NeuralField, sdf: Tensor, rays: RayBatch, far_m: float, step_m: float) -> Tensor:
    """(N,) z-depth at which each ray hits the field, whose distances are `sdf` (R,), metres; 0 = no hit."""
    return cast_rays(field.grid, sdf, field.known, rays.origins, rays.directions, far_m, step_m)


def render_rays(
    field: NeuralField, origins: Tensor, directions: Tensor, z: Tensor, sharpness_voxels: float
) -> RenderedRays:
    """Render rays (N, 3), (N, 3) at sample depths z (N, S), metres, ascending. Differentiable in the field.

    `sharpness_voxels`: width of the rendering weights around the surface.
    """
    points = origins[:, None] + directions[:, None] * z[..., None]
    sdf, rgb, known = field(points.view(-1, 3))
    known = known.view(z.shape)
    weights = sdf_weights(sdf.view(z.shape), known, sharpness_voxels * field.grid.voxel_size_m)
    depth, _ = render_depth(weights, z)
    # Colour is fused in a narrower band than distances, so it must not move the surface: weights are detached.
    color = render_values(weights.detach(), rgb.view(*z.shape, 3))
    return RenderedRays(depth, color, known.sum(1) >= 3)


def refine(
    field: NeuralField,
    batches: Sequence[RayBatch],
    config: FieldConfig,
    far_m: float,
    step_m: float,
    generator: torch.Generator,
    on_event: OnEvent = ignore,
) -> list[float]:
    """Minimise the mapping loss of UncLe-SLAM (docs/uncle-paper.md) over `config.rays` rays in each step, as many of
    each of `batches`; returns the mean negative log-likelihood of each step, nats.

    The loss is the sum over sources of reliability * (|D_s - D_hat| / beta_s + log(2 beta_s)), plus the colour term.
    The noise models stay fixed: the field adapts to its own rays, so residuals to it would make beta too small.
    """
    if config.iterations == 0 or not batches:
        return []
    sdf = field.sdf_table()
    samplers = [_RaySampler.of(rays, surface_depths(field, sdf, rays, far_m, step_m)) for rays in batches]
    samplers = [sampler for sampler in samplers if len(sampler.usable)]
    if not samplers:
        return []
    fine, coarse = Adam([field.fine]), Adam([*field.levels.parameters(), *field.decoder.parameters()])
    losses, rays_each = [], config.rays // len(samplers)
    steps = range(config.iterations)
    for step in track_progress(steps, config.iterations, "refining the field", on_event, "steps"):
        draws = [sampler.draw(rays_each, config, field.grid.voxel_size_m, generator) for sampler in samplers]
        terms = [_terms(field, *draw, config) for draw in draws]
        loss, nats = _loss(field, terms, config)
        for optimizer in (fine, coarse):
            optimizer.zero_grad()
        loss.backward()
        decay = config.final_rate_ratio ** (step / config.iterations)
        fine.step(config.learning_rate_sdf_m * decay)
        coarse.step(config.learning_rate * decay)
        losses.append(float(nats))
    return losses


@dataclass(frozen=True)
class _RaySampler:
    """Rays to draw from: `usable` (U,) rows of `rays` hit the field, at the depths `surface` (N,) metres."""

    rays: RayBatch
    surface: Tensor
    usable: Tensor

    @staticmethod
    def of(rays: RayBatch, surface: Tensor) -> _RaySampler:
        return _RaySampler(rays, surface, (surface > 0).nonzero()[:, 0])

    def draw(
        self, count: int, config: FieldConfig, voxel_size_m: float, generator: torch.Generator
    ) -> tuple[RayBatch, Tensor]:
        """`count` of the rays, and on each stratified sample depths (count, config.samples) around the surface."""
        samples = config.samples
        picks = torch.randint(len(self.usable), (count,), generator=generator)
        rows = self.usable[picks.to(self.usable.device)]
        cells = torch.arange(samples) + torch.rand(count, samples, generator=generator)
        offsets = (cells / samples * 2 - 1) * config.span_voxels * voxel_size_m
        return self.rays.at(rows), self.surface[rows][:, None] + offsets.to(rows.device)


@dataclass(frozen=True)
class _Terms:
    """Sums over the measurements of a batch: negative log-likelihood, nats, with and without the reliability factor,
    and their number; mean error of the rendered colour, 0 where it is not fitted."""

    weighted_nats: Tensor
    nats: Tensor
    count: Tensor
    color: Tensor


def _terms(field: NeuralField, rays: RayBatch, z: Tensor, config: FieldConfig) -> _Terms:
    rendered = render_rays(field, rays.origins, rays.directions, z, config.sharpness_voxels)
    used = rendered.known[:, None] & (rays.depths > 0)
    nats = laplace_nll((rays.depths - rendered.depth[:, None])[used], rays.betas[used])
    reliability = rays.reliability.expand_as(rays.depths)[used]
    color = nats.new_zeros(())
    if rays.colors is not None:
        error = (rendered.color - rays.colors.float() / 255).abs().sum(1)
        color = (error * rendered.known).sum() / rendered.known.sum().clamp(min=1)
    return _Terms((reliability * nats).sum(), nats.detach().sum(), used.sum(), color)


def _loss(field: NeuralField, terms: list[_Terms], config: FieldConfig) -> tuple[Tensor, Tensor]:
    """The loss, and the mean negative log-likelihood of a measurement, nats."""
    count = _sum(term.count for term in terms).clamp(min=1)
    likelihood = _sum(term.weighted_nats for term in terms) / count
    prior = (field.fine[:, 0] / field.grid.voxel_size_m).square().mean()
    loss = likelihood + config.color_weight * _sum(term.color for term in terms) + config.prior_weight * prior
    return loss, _sum(term.nats for term in terms) / count


def _sum(terms: Iterable[Tensor]) -> Tensor:
    first, *others = terms
    return sum(others, start=first)


def refine_map(
    volume: TsdfVolume, batches: Sequence[RayBatch], config: MapConfig, photometric: bool, on_event: OnEvent = ignore
) -> tuple[NeuralField, list[float]]:
    """The field made of the fused map, refined by `batches`, and the mean negative log-likelihood of each step, nats.

    `photometric`: photometric depth is among the batches. Without it the refinement would re-fit correlated sensor
    errors, so the learning rate of the feature grids is reduced.
    """
    generator = torch.Generator().manual_seed(config.seed)
    weight_scale_m = WEIGHT_SCALE_M if config.uncertainty.enabled else None
    settings = config.field
    field = NeuralField.from_fusion(volume, config.fusion.min_observations, settings, generator, weight_scale_m)
    if not photometric:
        rate = settings.sensor_only_rate_ratio * settings.learning_rate
        settings = settings.model_copy(update={"learning_rate": rate})
    return field, refine(field, batches, settings, volume.ray_far_m, volume.ray_step_m, generator, on_event)
