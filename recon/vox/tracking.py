"""Tracking: the pose from which the map looks like the frame."""

from __future__ import annotations

import torch
from torch import Tensor

from .config import VoxConfig
from .losses import Counts, vox_loss, without_outliers
from .mapping import hit_alone, sample_rays
from .model import VoxModel
from .pose import moved
from .rendering import render
from .views import VoxView


def track(
    model: VoxModel, view: VoxView, directions: Tensor, generator: torch.Generator, config: VoxConfig
) -> tuple[Tensor, bool]:
    """T_world_camera (4, 4) of `view`, looked for from the pose that it has; and whether any ray met the map.

    directions (P, 3) of all pixels in the camera. METHOD, Baselines: Adam on se(3), new rays in each step.
    """
    start = view.T_world_camera
    motion = torch.zeros(6, device=start.device, requires_grad=True)
    optimizer = torch.optim.Adam([motion], lr=config.tracking_rate)
    met = torch.zeros((), dtype=torch.bool, device=start.device)
    with model.held():
        for pixels in view.draws(config.tracking_rays, config.tracking_iterations, generator):
            optimizer.zero_grad(set_to_none=True)
            offset = torch.rand(len(pixels), generator=generator, device=generator.device)
            loss, met = pose_loss(model, view, directions, pixels, offset, motion, config)
            if not loss.requires_grad:
                return start, False
            loss.backward()
            optimizer.step()
    with torch.no_grad():
        turn, centre = moved(start, motion)
        pose = torch.eye(4, device=start.device)
        pose[:3, :3], pose[:3, 3] = turn, centre
    return pose, bool(met)


def pose_loss(
    model: VoxModel, view: VoxView, directions: Tensor, pixels: Tensor, offset: Tensor, motion: Tensor,
    config: VoxConfig,
) -> tuple[Tensor, Tensor]:  # fmt: skip
    """Loss of the pixels (N,) of `view` after the camera moved by `motion` (6,); and whether any ray met the map.

    Where samples lie on a ray is held fixed: the gradient goes through what the map says at them.
    """
    turn, centre = moved(view.T_world_camera, motion)
    targets, rays = view.targets(pixels), directions[pixels]
    with torch.no_grad():
        samples = sample_rays(model, centre.expand(len(rays), 3), rays @ turn.T, targets.depths, offset)
        targets = hit_alone(targets, samples)
    ray, z, _ = samples.packed()
    rendered = render(model, (rays[ray] * z[:, None]) @ turn.T + centre, samples)
    targets = without_outliers(targets, rendered.depth.detach(), config.outlier_medians)
    counts = Counts.of(samples, targets, config.truncation_m)
    return vox_loss(rendered, samples, targets, counts, config), targets.valid.any()
