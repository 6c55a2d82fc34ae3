"""Refinement of the neural field by its rendering likelihood, weighed by the learned uncertainty and by what
readings are worth."""

from __future__ import annotations

from collections.abc import Sequence
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
from .mapper import Mapper
from .ray_batch import RayBatch

SPAN_VOXELS = 2.5  # samples reach this far before and behind the present surface
SHARPNESS_VOXELS = 0.4  # the bell must end within the span, or the rendered depth follows the surface only in part
_FINAL_RATE = 0.05  # share of the learning rate that is left at the end


@dataclass(frozen=True)
class RenderedRays:
    """depth (N,) metres, variance (N,) metres^2, color (N, 3) in 0..1, known (N,) bool: the ray met known samples."""

    depth: Tensor
    variance: Tensor
    color: Tensor
    known: Tensor


def surface_depths(field: NeuralField, sdf: Tensor, rays: RayBatch, far_m: float, step_m: float) -> Tensor:
    """(N,) z-depth at which each ray meets the field, of which `sdf` is the table, metres; 0 = it does not."""
    return cast_rays(field.grid, sdf, field.known, rays.origins, rays.directions, far_m, step_m)


def render_rays(field: NeuralField, origins: Tensor, directions: Tensor, z: Tensor) -> RenderedRays:
    """Render rays (N, 3), (N, 3) at sample depths z (N, S), metres, ascending. Differentiable in the field."""
    points = origins[:, None] + directions[:, None] * z[..., None]
    sdf, rgb, known = field(points.view(-1, 3))
    known = known.view(z.shape)
    weights = sdf_weights(sdf.view(z.shape), known, SHARPNESS_VOXELS * field.grid.voxel_size_m)
    depth, variance = render_depth(weights, z)
    # Colour is fused closer to the surface than distances are; it is fitted where the depth says the surface is.
    color = render_values(weights.detach(), rgb.view(*z.shape, 3))
    return RenderedRays(depth, variance, color, known.sum(1) >= 3)


def refine(
    field: NeuralField,
    readings: Sequence[RayBatch],
    config: FieldConfig,
    far_m: float,
    step_m: float,
    generator: torch.Generator,
    on_event: OnEvent = ignore,
) -> list[float]:
    """Minimise the paper's mapping loss over `config.rays` rays in each step, as many of each set of `readings`;
    returns the mean negative log-likelihood a step, nats.

    sum over sources of what a reading is worth times |D_s - D_hat| / beta_s + log(2 beta_s), plus the colour term. h_w
    stays as it was learned: the field comes to fit its own rays, and a beta that followed those residuals would promise
    too much.
    """
    if config.iterations == 0 or not readings:
        return []
    sdf = field.sdf_table()
    drawn = [_Draw.of(rays, surface_depths(field, sdf, rays, far_m, step_m)) for rays in readings]
    draws = [draw for draw in drawn if len(draw.usable)]
    if not draws:
        return []
    fine, coarse = Adam([field.fine]), Adam([*field.levels.parameters(), *field.decoder.parameters()])
    losses, share = [], config.rays // len(draws)
    steps = range(config.iterations)
    for step in track_progress(steps, config.iterations, "refining the field", on_event, "steps"):
        batches = [draw.some(share, config.samples, field.grid.voxel_size_m, generator) for draw in draws]
        terms = [_terms(field, *batch) for batch in batches]
        loss, nats = _loss(field, terms, config)
        for optimizer in (fine, coarse):
            optimizer.zero_grad()
        loss.backward()
        slower = _FINAL_RATE ** (step / config.iterations)
        fine.step(config.learning_rate_sdf_m * slower)
        coarse.step(config.learning_rate * slower)
        losses.append(float(nats))
    return losses


@dataclass(frozen=True)
class _Draw:
    """Rays to draw from: `usable` (U,) rows of `rays` meet the field, at the depths `surface` (N,) metres."""

    rays: RayBatch
    surface: Tensor
    usable: Tensor

    @staticmethod
    def of(rays: RayBatch, surface: Tensor) -> _Draw:
        return _Draw(rays, surface, (surface > 0).nonzero()[:, 0])

    def some(
        self, count: int, samples: int, voxel_size_m: float, generator: torch.Generator
    ) -> tuple[RayBatch, Tensor]:
        """`count` of the rays, and on each `samples` stratified depths (count, samples) around the surface."""
        picks = torch.randint(len(self.usable), (count,), generator=generator)
        rows = self.usable[picks.to(self.usable.device)]
        cells = torch.arange(samples) + torch.rand(count, samples, generator=generator)
        offsets = (cells / samples * 2 - 1) * SPAN_VOXELS * voxel_size_m
        return self.rays.at(rows), self.surface[rows][:, None] + offsets.to(rows.device)


@dataclass(frozen=True)
class _Terms:
    """Sums over the readings of a batch: likelihood, nats, each by what it is `worth` and as it is, and their number;
    and the mean error of the rendered colour, 0 where nothing is said of it."""

    worth_nats: Tensor
    nats: Tensor
    count: Tensor
    color: Tensor


def _terms(field: NeuralField, rays: RayBatch, z: Tensor) -> _Terms:
    rendered = render_rays(field, rays.origins, rays.directions, z)
    used = rendered.known[:, None] & (rays.depths > 0)
    nats = laplace_nll((rays.depths - rendered.depth[:, None])[used], rays.betas[used])
    worth = rays.worth.expand_as(rays.depths)[used]
    color = nats.new_zeros(())
    if rays.colors is not None:
        error = (rendered.color - rays.colors.float() / 255).abs().sum(1)
        color = (error * rendered.known).sum() / rendered.known.sum().clamp(min=1)
    return _Terms((worth * nats).sum(), nats.detach().sum(), used.sum(), color)


def _loss(field: NeuralField, terms: list[_Terms], config: FieldConfig) -> tuple[Tensor, Tensor]:
    """The loss, and the mean negative log-likelihood of a reading, nats."""
    count = sum(term.count for term in terms).clamp(min=1)
    likelihood = sum(term.worth_nats for term in terms) / count
    prior = (field.fine[:, 0] / field.grid.voxel_size_m).square().mean()
    loss = likelihood + config.color_weight * sum(term.color for term in terms) + config.prior_weight * prior
    return loss, sum(term.nats for term in terms) / count


LEARNING_RATE_FACTOR_WITHOUT_PHOTOMETRIC = 0.1  # of the step size of the feature grids, where colour says nothing


def refine_field(mapper: Mapper, config: MapConfig, on_event: OnEvent = ignore) -> tuple[NeuralField, list[float]]:
    """The field, and the mean negative log-likelihood of each step of its refinement, nats."""
    generator = torch.Generator().manual_seed(config.seed)
    stated = WEIGHT_SCALE_M if config.uncertainty.enabled else None
    field = NeuralField.from_fusion(mapper.volume, config.fusion.min_observations, config.field, generator, stated)
    far_m, step_m = mapper.volume.ray_far_m, mapper.volume.ray_step_m
    readings = mapper.ray_batches() if config.field.iterations else []
    losses = refine(field, readings, field_settings(mapper, config.field), far_m, step_m, generator, on_event)
    return field, losses


def field_settings(mapper: Mapper, config: FieldConfig) -> FieldConfig:
    """Sensors alone repeat the errors that the fused map has, or was cured of: without colour it is to move less."""
    if mapper.witness.samples:
        return config
    return config.model_copy(update={"learning_rate": LEARNING_RATE_FACTOR_WITHOUT_PHOTOMETRIC * config.learning_rate})
