"""The tracker: Adam on the camera against what the scene looks like from it (METHOD, Tracking)."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.map_config import MapConfig
from ..online import Found
from .objective import Evaluate, look, tracking_loss
from .poses import predicted, tidy, to_matrix, to_seven
from .scene import Scene
from .views import View, Window
from .weighting import Weighting


class NiceTracker:
    """Finds cameras in `scene`, which it leaves as it is; `draws` is a generator of the scene's device."""

    def __init__(
        self, scene: Scene, weighting: Weighting, camera: Camera, config: MapConfig, evaluate: Evaluate,
        draws: torch.Generator,
    ) -> None:  # fmt: skip
        self.scene, self.weighting, self.camera, self.evaluate = scene, weighting, camera, evaluate
        self.config, self.settings, self.draws = config, config.nice_tracking, draws

    def track(self, view: View, recent: list[np.ndarray]) -> Found:
        """The best of the poses that Adam passes, from that of constant velocity; lost where no reading is usable."""
        self.scene.hold()
        settings, reproduce_released_code = self.settings, self.config.nice.reproduce_released_code
        window = Window(
            [view], self.camera, self.weighting.patch_size, self.weighting.color_patch, settings.edge
        )  # fmt: skip
        start = to_seven(predicted(recent)).to(self.scene.device)
        rotation, centre = start[:4].clone().requires_grad_(), start[4:].clone().requires_grad_()
        rates = [settings.learning_rate * settings.rotation_factor, settings.learning_rate]
        groups = [{"params": [p], "lr": rate} for p, rate in zip((rotation, centre), rates, strict=True)]
        adam = torch.optim.Adam(groups, fused=True)
        late = (
            reproduce_released_code and settings.rotation_factor == 1.0
        )  # the published code keeps the pose after the step
        best, least = start, torch.full((), torch.inf, device=start.device)
        for _ in range(settings.iterations):
            seven = torch.cat([rotation, centre])
            loss = self.loss(window, to_matrix(seven[None]))
            adam.zero_grad(set_to_none=True)
            loss.backward()
            before = seven.detach().clone()
            adam.step()
            candidate = torch.cat([rotation, centre]).detach() if late else before
            better = loss.detach() < least
            best, least = torch.where(better, candidate, best), torch.where(better, loss.detach(), least)
        if not bool(torch.isfinite(least) & torch.isfinite(best).all()):
            return Found(None, "lost")
        return Found(tidy(to_matrix(best[None])[0]))

    def loss(self, window: Window, poses: Tensor) -> Tensor:
        """Of fresh random pixels; poses (1, 4, 4)."""
        colored = self.config.tracking.color and self.config.nice.color
        rays = window.draw(self.settings.pixels, self.draws)
        picture = look(
            rays, poses, self.evaluate, self.scene.bound, "color" if colored else "fine", self.config.nice
        )  # fmt: skip
        return tracking_loss(picture, rays, self.weighting, self.config.nice.reproduce_released_code)
