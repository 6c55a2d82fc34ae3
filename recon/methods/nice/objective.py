"""Rendering rays of posed views and the two losses that follow (METHOD, Mapping and Tracking)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from ...core.config.nice import NiceConfig
from .rays import box_exit, render, sample_depths
from .scene import Stage, Values
from .views import Rays
from .weighting import Weighting

Evaluate = Callable[[Tensor, Stage], Values]  # points (R, S, 3) of R rays, front to back
OUTLIER = 10.0  # medians of the tracking residuals; pixels beyond take no part


@dataclass(frozen=True)
class Picture:
    """What rays see of the scene: depth (N,) metres, spread (N,) metres (S-hat), colors (N, 3) or None; inside (N,):
    whether a ray meets its first reading before it leaves the box."""

    depth: Tensor
    spread: Tensor
    colors: Tensor | None
    inside: Tensor


def look(
    rays: Rays, T_world_camera: Tensor, evaluate: Evaluate, bound: Tensor, stage: Stage, config: NiceConfig
) -> Picture:
    """Render `rays` of views at poses (M, 4, 4). Gradients reach the poses through the samples' positions alone."""
    origins, directions = rays.posed(T_world_camera)
    with torch.no_grad():
        exits = box_exit(origins, directions, bound)
        z = sample_depths(rays.depths, exits, config.uniform_samples, config.surface_samples)
    points = origins[:, None] + directions[:, None] * z[..., None]
    values = evaluate(points, stage)
    seen = render(values.logits, z)
    colors = None if values.colors is None else (seen.weights[..., None] * values.colors).sum(1)
    spread = seen.variance.detach().sqrt()
    return Picture(seen.depth, spread, colors, exits >= rays.depths[:, 0])


def mapping_loss(picture: Picture, rays: Rays, weighting: Weighting, stage: Stage) -> Tensor:
    """Sum over rays and sensors."""
    valid = (rays.depths > 0) & picture.inside[:, None]
    loss = weighting.depth_loss((rays.depths - picture.depth[:, None]).abs(), valid, rays, stage)
    errors = torch.zeros_like(picture.depth)
    if picture.colors is not None:
        errors = (rays.colors - picture.colors).abs().sum(1)
    return loss + weighting.color_loss(errors, rays.colors, picture.inside, rays, stage)


def tracking_loss(picture: Picture, rays: Rays, weighting: Weighting, reproduce_released_code: bool) -> Tensor:
    """Mean over the pixels that are no outliers, of all sensors together, and colour on the same pixels (D1, D2).

    The published code keeps the last sensor alone, and sums. NaN where no reading is left.
    """
    scaled = (rays.depths - picture.depth[:, None]).abs() / weighting.spread(picture.spread, rays)
    inside = picture.inside[:, None]
    medians = torch.where(inside, scaled.detach(), torch.nan).nanmedian(dim=0).values
    kept = inside & (rays.depths > 0) & (scaled.detach() < OUTLIER * medians)
    if reproduce_released_code:
        kept = kept & (torch.arange(kept.shape[1], device=kept.device) == kept.shape[1] - 1)
    depth = torch.where(kept, scaled, 0.0).sum(0)
    counts = torch.ones_like(depth) if reproduce_released_code else kept.sum(0).clamp(min=1)
    loss = (depth / counts).sum()
    if picture.colors is not None:
        errors = (rays.colors - picture.colors).abs().sum(1) * weighting.color_scale(rays)
        used = kept[:, -1] if reproduce_released_code else kept.any(1)
        loss = loss + torch.where(used, errors, 0.0).sum() / (1 if reproduce_released_code else used.sum().clamp(min=1))
    return torch.where(kept.any(), loss, torch.nan)
