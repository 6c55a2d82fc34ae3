"""Mapping: voxels around the measurements of a frame, then steps of Adam on rays of a window of frames."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from .intersect import intersect
from .losses import Counts, Targets, vox_loss
from .model import VoxModel
from .rendering import render
from .sampling import Samples, place_samples
from .views import VoxView

_RAYS_AT_A_TIME = {"cpu": 256}  # their samples fit the cache; a GPU takes all


def sample_rays(model: VoxModel, origins: Tensor, directions: Tensor, depths: Tensor, offset: Tensor) -> Samples:
    """Samples on rays (N, 3), (N, 3) with measurements (N, K), metres; offset (N,) as in `place_samples`."""
    config = model.config
    farthest = depths.amax(1)
    far = torch.where(farthest > 0, farthest + config.behind_m, config.max_depth_m)
    hits = intersect(model.voxels.voxels, origins, directions, far, config.max_voxels)
    return place_samples(hits, config.step_voxels * config.voxel_size_m, offset)


class VoxMapper:
    """The model, and the keyframes that keep it from forgetting."""

    def __init__(self, model: VoxModel, directions: Tensor, generator: torch.Generator) -> None:
        self.model, self.config, self.directions, self.generator = model, model.config, directions, generator
        self.keyframes: list[VoxView] = []
        self.losses: list[float] = []  # mean of the steps of each mapped frame

    def map(self, view: VoxView) -> None:
        """Make a posed view part of the map, if it has measurements."""
        if not len(view.usable):
            return
        self.model.add_points(view.points(self.directions))
        steps = self.config.iterations if self.keyframes else self.config.first_iterations
        self._optimise([*self._window(), view], steps)
        if not self.keyframes or view.index - self.keyframes[-1].index > self.config.keyframe_every:
            self.keyframes.append(view)

    def _window(self) -> list[VoxView]:
        """Random keyframes, at most `window`."""
        order = torch.randperm(len(self.keyframes), generator=self.generator, device=self.generator.device)
        return [self.keyframes[i] for i in order.tolist()[: self.config.window]]

    def _optimise(self, views: list[VoxView], steps: int) -> None:
        origins, directions, targets = self._rays(views, steps)
        total = torch.zeros((), device=self.model.device)
        for step in range(steps):
            self.model.optimizer.zero_grad(set_to_none=True)
            total += self._accumulate(origins, directions[step], targets[step])
            self.model.optimizer.step()
        self.losses.append(float(total) / steps)

    def _rays(self, views: list[VoxView], steps: int) -> tuple[Tensor, Tensor, Targets]:
        """Rays of all steps: origins (N, 3), the same in each; directions (steps, N, 3) and targets of (steps, N)."""
        poses = [view.T_world_camera for view in views]
        pixels = [view.draw(self.config.rays, steps, self.generator) for view in views]
        origins = [T[:3, 3].expand(own.shape[1], 3) for T, own in zip(poses, pixels, strict=True)]
        directions = [self.directions[own] @ T[:3, :3].T for T, own in zip(poses, pixels, strict=True)]
        seen = [view.targets(own) for view, own in zip(views, pixels, strict=True)]
        parts = (torch.cat([getattr(own, name) for own in seen], 1) for name in ("colors", "depths", "valid"))
        return torch.cat(origins), torch.cat(directions, 1), Targets(*parts)

    def _accumulate(self, origins: Tensor, directions: Tensor, targets: Targets) -> Tensor:
        """Gradients of the loss on rays (N, 3), (N, 3); returns the loss."""
        offset = torch.rand(len(origins), generator=self.generator, device=self.generator.device)
        samples = sample_rays(self.model, origins, directions, targets.depths, offset)
        targets = hit_alone(targets, samples)
        counts = Counts.of(samples, targets, self.config.truncation_m)
        total = torch.zeros((), device=origins.device)
        size = _RAYS_AT_A_TIME.get(origins.device.type, len(origins))
        for first in range(0, len(origins), size):
            rays = slice(first, first + size)
            own = samples if size >= len(origins) else samples.of_rays(first, first + size)
            ray, z, _ = own.packed()
            points = origins[rays][ray] + directions[rays][ray] * z[:, None]
            loss = vox_loss(render(self.model, points, own), own, targets[rays], counts, self.config)
            if loss.requires_grad:
                loss.backward()
            total += loss.detach()
        return total

    def state_dict(self) -> dict[str, Any]:
        """Keyframes and losses, as plain tensors and containers."""
        return {"keyframes": [vars(view) for view in self.keyframes], "losses": list(self.losses)}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from what `state_dict` returned."""
        device = self.model.device
        self.keyframes = [VoxView(**view).to(device) for view in state["keyframes"]]
        self.losses = list(state["losses"])


def hit_alone(targets: Targets, samples: Samples) -> Targets:
    """Rays that meet no voxel say nothing."""
    return Targets(targets.colors, targets.depths, targets.valid & samples.there.any(1, keepdim=True))
