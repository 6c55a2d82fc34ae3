"""Tracking: the pose at which the rendered map matches the frame."""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.config.vox import VoxConfig
from .losses import Counts, Targets, vox_loss, without_outliers
from .mapping import hit_alone, sample_rays
from .model import VoxModel
from .pose import moved
from .rendering import render
from .views import VoxView


def track(
    model: VoxModel, view: VoxView, directions: Tensor, generator: torch.Generator, config: VoxConfig
) -> tuple[Tensor, bool]:
    """T_world_camera (4, 4) of `view`, optimised from the pose that it has; and whether any ray met the map.

    directions (P, 3) of all pixels in the camera. Adam on translation and rotation vector, with new rays in each step.
    """
    start = view.T_world_camera
    pixels = view.draw(config.tracking_rays, config.tracking_iterations, generator)
    rays, targets = directions[pixels], view.targets(pixels)
    offset = torch.rand(pixels.shape, generator=generator, device=generator.device)
    motion = torch.zeros(6, device=start.device, requires_grad=True)
    optimizer = torch.optim.Adam([motion], lr=config.tracking_rate, fused=start.is_cuda)
    met = torch.zeros((), dtype=torch.bool, device=start.device)
    with model.held():
        for step in range(len(pixels)):
            optimizer.zero_grad(set_to_none=True)
            loss, met = pose_loss(model, start, motion, rays[step], targets[step], offset[step], config)
            if not loss.requires_grad:
                return start, False
            loss.backward()
            optimizer.step()
    with torch.no_grad():
        pose = torch.eye(4, device=start.device)
        pose[:3, :3], pose[:3, 3] = moved(start, motion)
    return pose, bool(met)


def pose_loss(
    model: VoxModel, start: Tensor, motion: Tensor, rays: Tensor, targets: Targets, offset: Tensor, config: VoxConfig
) -> tuple[Tensor, Tensor]:
    """Loss of rays (N, 3) of a camera at `start` (4, 4) moved by `motion` (6,); and whether any of them met the map.

    Where samples lie on a ray is held fixed: the gradient goes through what the map says at them.
    """
    turn, centre = moved(start, motion)
    with torch.no_grad():
        samples = sample_rays(model, centre.expand(len(rays), 3), rays @ turn.T, targets.depths, offset)
        targets = hit_alone(targets, samples)
    ray, z, _ = samples.packed()
    rendered = render(model, (rays[ray] * z[:, None]) @ turn.T + centre, samples)
    targets = without_outliers(targets, rendered.depth.detach(), config.outlier_medians)
    counts = Counts.of(samples, targets, config.truncation_m)
    return vox_loss(rendered, samples, targets, counts, config), targets.valid.any()
