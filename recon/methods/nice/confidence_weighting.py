"""Weights from the confidence of a pretrained network: the method `nice-slam-pre`."""

from __future__ import annotations

import torch
from torch import Tensor

from ...core.config.nice import NiceConfig, NiceTrackingConfig
from ...core.frame import Frame
from ..confidence.models import ConfidenceModels
from .views import Rays
from .weighting import Normals, UniformWeighting

MIN_CONFIDENCE = 1e-3  # keeps the scale of a residual without any confidence finite


class ConfidenceWeighting(UniformWeighting):
    """NICE-SLAM with c |D - D-hat| in mapping, in all stages, and c |D - D-hat| / S-hat in tracking.

    How the comparison of UncLe-SLAM uses its confidences is not published; this is the plainest way.
    """

    def __init__(
        self, config: NiceConfig, tracking: NiceTrackingConfig, models: ConfidenceModels, device: torch.device
    ) -> None:
        super().__init__(config, tracking)
        self.models, self.device = models, device

    def weighting_inputs(self, frame: Frame, normals: Normals) -> Tensor:
        """Confidence (K, 1, H, W) of each depth; 1 where there is none, which takes no part in a loss."""
        images = []
        for sensor, depth in frame.depths.items():
            confidence = self.models.image(sensor, depth.to(self.device)).cpu().clamp(min=MIN_CONFIDENCE)
            images.append(torch.where(depth > 0, confidence, 1.0))
        return torch.stack(images)[:, None]

    def confidence(self, rays: Rays) -> Tensor:
        """Factor (N, K) of the residuals."""
        return rays.weighting_inputs[..., 0]
