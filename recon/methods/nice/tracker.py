"""The tracker: Adam on the camera pose against the rendered scene (docs/uncle-paper.md, Tracking)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.map_config import MapConfig
from ...core.se3 import predict_pose
from ..online import Found
from .objective import Evaluate, render_rays, tracking_loss
from .poses import to_pose_matrix, to_pose_vector, to_rigid
from .scene import GridScene, Stage
from .views import PreparedFrame, Window
from .weighting import Weighting


class NiceTracker:
    """Finds camera poses in `scene`, which it does not change; `draws` is a generator of the scene's device."""

    def __init__(
        self, scene: GridScene, weighting: Weighting, camera: Camera, config: MapConfig, evaluate: Evaluate,
        draws: torch.Generator,
    ) -> None:  # fmt: skip
        self.scene, self.weighting, self.camera, self.evaluate = scene, weighting, camera, evaluate
        self.config, self.settings, self.draws = config, config.nice_tracking, draws

    def track(self, view: PreparedFrame, recent: list[np.ndarray]) -> Found:
        """The pose with the least loss of those that Adam passes, from that of constant velocity.

        Lost where no depth can be compared. `recent`: the last poses (4, 4), the newest last.
        """
        self.scene.freeze()
        settings, released = self.settings, self.config.nice.reproduce_released_code
        weighting = self.weighting
        window = Window([view], self.camera, weighting.patch_size, weighting.color_patch, settings.edge)
        start = to_pose_vector(predict_pose(recent)).to(self.scene.device)
        rotation, centre = start[:4].clone().requires_grad_(), start[4:].clone().requires_grad_()
        rates = [settings.learning_rate * settings.rotation_factor, settings.learning_rate]
        groups = [{"params": [p], "lr": rate} for p, rate in zip((rotation, centre), rates, strict=True)]
        adam = torch.optim.Adam(groups, fused=True)
        keeps_next = released and settings.rotation_factor == 1.0  # docs/uncle-paper.md, difference 9
        best, least = start, torch.full((), torch.inf, device=start.device)
        for _ in range(settings.iterations):
            pose_vector = torch.cat([rotation, centre])
            loss = self.loss(window, to_pose_matrix(pose_vector[None]))
            adam.zero_grad(set_to_none=True)
            loss.backward()
            before = pose_vector.detach().clone()
            adam.step()
            candidate = torch.cat([rotation, centre]).detach() if keeps_next else before
            better = loss.detach() < least
            best, least = torch.where(better, candidate, best), torch.where(better, loss.detach(), least)
        if not bool(torch.isfinite(least) & torch.isfinite(best).all()):
            return Found(None, "lost")
        return Found(to_rigid(to_pose_matrix(best[None])[0]))

    def loss(self, window: Window, poses: Tensor) -> Tensor:
        """Tracking loss of newly drawn pixels; poses (1, 4, 4)."""
        uses_color = self.config.tracking.color and self.config.nice.color
        rays = window.draw(self.settings.pixels, self.draws)
        stage: Stage = "color" if uses_color else "fine"
        rendered = render_rays(rays, poses, self.evaluate, self.scene.bound, stage, self.config.nice)
        return tracking_loss(rendered, rays, self.weighting, self.config.nice.reproduce_released_code)
