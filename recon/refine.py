"""Refinement of the neural field by its rendering likelihood, weighed by the learned uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .adam import Adam
from .config import FieldConfig
from .events import OnEvent, ignore, track_progress
from .field import NeuralField
from .keyframes import RayStore
from .losses import laplace_nll
from .raycast import cast_rays
from .rendering import render_depth, render_values, sdf_weights
from .uncertainty import START_BETA_M, NoiseModel

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


def surface_depths(field: NeuralField, rays: RayStore, far_m: float, step_m: float) -> Tensor:
    """(N,) z-depth at which each stored ray meets the field, metres; 0 = it does not."""
    sdf = field.sdf_table()
    return cast_rays(field.grid, sdf, field.known, rays["origins"], rays["directions"], far_m, step_m)


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
    rays: RayStore,
    noise: dict[str, NoiseModel],
    config: FieldConfig,
    far_m: float,
    step_m: float,
    generator: torch.Generator,
    on_event: OnEvent = ignore,
) -> list[float]:
    """Minimise the paper's mapping loss over all keyframe rays; returns the mean negative log-likelihood a step, nats.

    sum over sensors of |D_s - D_hat| / beta_s + log(2 beta_s), plus the colour term. h_w stays as it was learned: the
    field comes to fit its own rays, and a beta that followed those residuals would promise too much.
    """
    if config.iterations == 0 or len(rays) == 0:
        return []
    surface = surface_depths(field, rays, far_m, step_m)
    usable = (surface > 0).nonzero()[:, 0]
    if len(usable) == 0:
        return []
    fine, coarse = Adam([field.fine]), Adam([*field.levels.parameters(), *field.decoder.parameters()])
    losses = []
    steps = range(config.iterations)
    for step in track_progress(steps, config.iterations, "refining the field", on_event, "steps"):
        batch = usable[torch.randint(len(usable), (config.rays,), generator=generator).to(usable.device)]
        loss, likelihood = _loss(
            field, rays, noise, config, batch, _sample_depths(field, surface[batch], config, generator)
        )
        for optimizer in (fine, coarse):
            optimizer.zero_grad()
        loss.backward()
        slower = _FINAL_RATE ** (step / config.iterations)
        fine.step(config.learning_rate_sdf_m * slower)
        coarse.step(config.learning_rate * slower)
        losses.append(float(likelihood))
    return losses


def _sample_depths(field: NeuralField, surface: Tensor, config: FieldConfig, generator: torch.Generator) -> Tensor:
    """(N,) -> (N, S) stratified depths around the surface."""
    cells = torch.arange(config.samples) + torch.rand(len(surface), config.samples, generator=generator)
    offsets = (cells / config.samples * 2 - 1) * SPAN_VOXELS * field.grid.voxel_size_m
    return surface[:, None] + offsets.to(surface.device)


def _loss(field, rays, noise, config, batch, z) -> tuple[Tensor, Tensor]:
    rendered = render_rays(field, rays["origins"][batch], rays["directions"][batch], z)
    depths, features = rays["depths"][batch], rays["features"][batch]
    total, count = rendered.depth.new_zeros(()), rendered.depth.new_zeros(())
    for column, model in enumerate(noise.values()):
        used = rendered.known & (depths[:, column] > 0)
        with torch.no_grad():
            seen = features[used, column].float()
            beta = model(seen) if seen.shape[-1] else torch.full_like(depths[used, column], START_BETA_M)
        total = total + laplace_nll(depths[used, column] - rendered.depth[used], beta).sum()
        count = count + used.sum()
    likelihood = total / count.clamp(min=1)
    color_error = (rendered.color - rays["colors"][batch].float() / 255).abs().sum(1)
    color = (color_error * rendered.known).sum() / rendered.known.sum().clamp(min=1)
    prior = (field.fine[:, 0] / field.grid.voxel_size_m).square().mean()
    return likelihood + config.color_weight * color + config.prior_weight * prior, likelihood.detach()
