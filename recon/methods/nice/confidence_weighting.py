"""Readings weighed by the confidence of a trained network: the method `nice-slam-pre`."""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.config.nice import NiceConfig, NiceTrackingConfig
from ...core.frame import Frame
from ..confidence.models import ConfidenceModels
from .views import Rays
from .weighting import Normals, UniformWeighting

LEAST = 1e-3  # keeps the denominator of a reading that is not trusted at all finite


class ConfidenceWeighting(UniformWeighting):
    """As NICE-SLAM, with c |D - D-hat| in mapping, in all stages, and c |D - D-hat| / S-hat in tracking.

    How the paper's comparison uses its confidences is not published; this is the plainest way.
    """

    def __init__(
        self, config: NiceConfig, tracking: NiceTrackingConfig, models: ConfidenceModels, device: torch.device
    ) -> None:
        super().__init__(config, tracking)
        self.models, self.device = models, device

    def weighting_inputs(self, frame: Frame, normals: Normals) -> Tensor:
        """(K, 1, H, W): the confidence of each reading; 1 where there is none, which takes no part in a loss."""
        images = []
        for sensor, depth in frame.depths.items():
            confidence = self.models.image(sensor, depth.to(self.device)).cpu().clamp(min=LEAST)
            images.append(torch.where(depth > 0, confidence, 1.0))
        return torch.stack(images)[:, None]

    def confidence(self, rays: Rays) -> Tensor:
        return rays.weighting_inputs[..., 0]
