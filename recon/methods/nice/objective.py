"""Rendering of rays of posed frames, and the losses of mapping and tracking (docs/uncle-paper.md, Losses)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.config.nice import NiceConfig
from .rays import box_exit, render_depth, sample_depths
from .scene import FieldValues, Stage
from .views import Rays
from .weighting import Weighting

Evaluate = Callable[[Tensor, Stage], FieldValues]  # points (R, S, 3) of R rays, front to back
OUTLIER_MEDIANS = 10.0  # pixels whose tracking residual exceeds so many medians take no part; NICE-SLAM


@dataclass(frozen=True)
class RenderedRays:
    """What N rays show of the scene.

    depth (N,) metres; spread (N,) metres, S-hat; colors (N, 3) or None; inside (N,) bool: whether the ray leaves the
    box behind the depth of the first sensor.
    """

    depth: Tensor
    spread: Tensor
    colors: Tensor | None
    inside: Tensor


def render_rays(
    rays: Rays, T_world_camera: Tensor, evaluate: Evaluate, bound: Tensor, stage: Stage, config: NiceConfig
) -> RenderedRays:
    """Render `rays` of frames at poses (M, 4, 4). Gradients reach the poses through the samples' positions only."""
    origins, directions = rays.posed(T_world_camera)
    with torch.no_grad():
        exits = box_exit(origins, directions, bound)
        z = sample_depths(rays.depths, exits, config.uniform_samples, config.surface_samples)
    points = origins[:, None] + directions[:, None] * z[..., None]
    values = evaluate(points, stage)
    rendered = render_depth(values.logits, z)
    colors = None if values.colors is None else (rendered.weights[..., None] * values.colors).sum(1)
    spread = rendered.variance.detach().sqrt()
    return RenderedRays(rendered.depth, spread, colors, exits >= rays.depths[:, 0])


def mapping_loss(rendered: RenderedRays, rays: Rays, weighting: Weighting, stage: Stage) -> Tensor:
    """Sum over rays and sensors."""
    valid = (rays.depths > 0) & rendered.inside[:, None]
    loss = weighting.depth_loss((rays.depths - rendered.depth[:, None]).abs(), valid, rays, stage)
    errors = torch.zeros_like(rendered.depth)
    if rendered.colors is not None:
        errors = (rays.colors - rendered.colors).abs().sum(1)
    return loss + weighting.color_loss(errors, rays.colors, rendered.inside, rays, stage)


def tracking_loss(rendered: RenderedRays, rays: Rays, weighting: Weighting, released: bool) -> Tensor:
    """Sum over sensors of the mean residual of pixels that are no outliers, plus the mean colour error there.

    `released`: as in the released code the last sensor alone, and sums instead of means (docs/uncle-paper.md,
    differences 1 and 2). NaN where no depth is left.
    """
    scaled = (rays.depths - rendered.depth[:, None]).abs() / weighting.residual_scale(rendered.spread, rays)
    inside = rendered.inside[:, None]
    medians = torch.where(inside, scaled.detach(), torch.nan).nanmedian(dim=0).values
    kept = inside & (rays.depths > 0) & (scaled.detach() < OUTLIER_MEDIANS * medians)
    if released:
        kept = kept & (torch.arange(kept.shape[1], device=kept.device) == kept.shape[1] - 1)
    depth = torch.where(kept, scaled, 0.0).sum(0)
    counts = torch.ones_like(depth) if released else kept.sum(0).clamp(min=1)
    loss = (depth / counts).sum()
    if rendered.colors is not None:
        errors = (rays.colors - rendered.colors).abs().sum(1) * weighting.color_factor(rays)
        used = kept[:, -1] if released else kept.any(1)
        loss = loss + torch.where(used, errors, 0.0).sum() / (1 if released else used.sum().clamp(min=1))
    return torch.where(kept.any(), loss, torch.nan)
