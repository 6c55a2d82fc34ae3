"""Depth bias of a sensor as a function of its image, fitted to photometric depth.

A sensor whose bias is the same from every viewpoint makes a biased map, so the map cannot reveal it. Photometric depth
is noisy, but its median is unbiased if poses and colour calibration are right (`bias_validation` tests that). Biases
below the possible bias of photometric depth itself are not corrected.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..core.config.uncle import UncertaintyConfig
from ..sensors.noise_inputs import SENSOR_INPUTS, relative_spread
from ..sensors.noise_model import PixelNetwork, Residuals


@dataclass(frozen=True)
class BiasModelParameters:
    """Constants of bias models.

    output_scale_m: metres per unit of network output; max_relative_spread: spread of depth around a pixel, relative to
    the depth, from which on it is an edge, where matching windows cover two surfaces; photometric_bias_limit: possible
    bias of photometric depth that all views share, in units of its beta (residuals of two sensors agreed on 0.26 to
    0.36).
    """

    output_scale_m: float = 0.1
    max_relative_spread: float = 0.05
    photometric_bias_limit: float = 0.35


class BiasModel(PixelNetwork):
    """(N, F) noise model inputs -> (N,) bias of a sensor, metres, positive = measures too far; 0 at depth edges."""

    active: Tensor

    def __init__(
        self,
        config: UncertaintyConfig,
        generator: torch.Generator,
        parameters: BiasModelParameters = BiasModelParameters(),
    ) -> None:
        super().__init__(config, generator, SENSOR_INPUTS, outputs=2, used_inputs=config.inputs)
        self.limits = parameters
        self.register_buffer("active", torch.zeros((), dtype=torch.bool))

    def forward(self, inputs: Tensor) -> Tensor:
        """(..., F) -> (...) metres."""
        return self.scale_and_offset(inputs)[1]

    def scale_and_offset(self, inputs: Tensor) -> tuple[Tensor, Tensor]:
        """(..., F) -> Laplace scale (...) and bias (...), metres."""
        outputs = self.outputs(inputs)
        smooth = relative_spread(inputs) < self.limits.max_relative_spread
        return self.scale(outputs), self.limits.output_scale_m * outputs[..., 1] * smooth

    def correct(self, depth: Tensor, inputs: Tensor) -> Tensor:
        """depth (H, W) metres as measured, inputs (H, W, F) -> depth (H, W) minus bias, active or not."""
        return (depth - self.image(depth, inputs)).clamp(min=0)

    @torch.no_grad()
    def exceeds_photometric_bias(self, residuals: Residuals, voxel_size_m: float) -> bool:
        """Whether the median bias, in units of the photometric beta, exceeds the limit of photometric depth's own bias.

        `residuals` to photometric depth are those that the model was fitted to. Only samples away from depth edges
        whose photometric beta is below `voxel_size_m` count.
        """
        inputs = residuals.inputs.float()
        used = (residuals.reference_scale < voxel_size_m) & (relative_spread(inputs) < self.limits.max_relative_spread)
        ratio = self(inputs[used].to(self.device)).abs().cpu() / residuals.reference_scale[used]
        return len(ratio) > 0 and float(ratio.median()) > self.limits.photometric_bias_limit

    @torch.no_grad()
    def offset(self, inputs: Tensor) -> Tensor | float:
        """(N, F) -> (N,) metres to subtract from the measurements; 0 unless the model is active."""
        return self(inputs.to(self.device)).to(inputs.device) if self.active else 0.0
