"""Where a sensor reads too near or too far: learned from colour, believed if its own readings then agree better.

A sensor that errs the same way from everywhere makes a map that errs with it, so the map cannot tell. What colour says
is noisy, but its middle is right where poses and the calibration of colour are. Whether they are is tested without it:
offsets that depend on what an image shows, such as the distance, make views of the same place disagree. Taking the
right ones off lets the views agree better, taking false ones off makes them agree less. What is less than colour
itself can be off by, in all views alike, is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import UncertaintyConfig
from ..sensors.noise_inputs import FEATURES, relative_spread
from ..sensors.noise_model import PixelNetwork, Residuals
from .multi_view_consistency import cross_view_residual

UNIT_M = 0.1  # of the network's output
EDGE = 0.05  # of the depth, its spread around a pixel: windows of colour hold two surfaces there, and find neither
MIN_OBSERVING_VIEWS = 3
MIN_MEASUREMENTS = 100  # of a view that are seen from others, to count it
PIXELS = 1500  # of a view that are compared
MIN_VIEWS = 3
PHOTOMETRIC_BIAS_LIMIT = (
    0.35  # betas: what colours of all views can be off alike; readings of two sensors agreed on 0.26 to 0.36
)
CONFIRMED, REFUTED = 0.75, 0.25  # share of the views that agree better, from which on, and up to which
NEAR_M = 1e-3  # readings that agree as well as this agree


class BiasModel(PixelNetwork):
    """(N, F) features -> (N,) how much too far a sensor reads, metres; nothing at edges of depth."""

    def __init__(self, config: UncertaintyConfig, generator: torch.Generator) -> None:
        super().__init__(config, generator, FEATURES, outputs=2)
        self.register_buffer("believed", torch.zeros((), dtype=torch.bool))

    def forward(self, features: Tensor) -> Tensor:
        return self.scale_and_offset(features)[1]

    def scale_and_offset(self, features: Tensor) -> tuple[Tensor, Tensor]:
        outputs, smooth = self.outputs(features), relative_spread(features) < EDGE
        return self.scale(outputs), UNIT_M * outputs[..., 1] * smooth

    def correct(self, depth: Tensor, features: Tensor) -> Tensor:
        """depth (H, W) metres as it is read, features (H, W, F) -> (H, W) as it should be."""
        return (depth - self.image(depth, features)).clamp(min=0)

    @torch.no_grad()
    def exceeds_photometric_bias(self, heard: Residuals, voxel_size_m: float) -> bool:
        """Whether it is, in the median, more than colour, which it was `heard` from, can be biased itself; of readings
        of colour that can tell samples of the map apart, away from edges of depth."""
        features = heard.features.float()
        sure = (heard.blur < voxel_size_m) & (relative_spread(features) < EDGE)
        in_betas = self(features[sure].to(self.device)).abs().cpu() / heard.blur[sure]
        return len(in_betas) > 0 and float(in_betas.median()) > PHOTOMETRIC_BIAS_LIMIT

    @torch.no_grad()
    def of(self, features: Tensor) -> Tensor | float:
        """(N,) metres to be taken off; 0 unless believed."""
        return self(features.to(self.device)).to(features.device) if self.believed else 0.0


@dataclass(frozen=True)
class DepthView:
    """depth (H, W) metres, 0 = none, and where it was taken."""

    depth: np.ndarray
    T_world_camera: np.ndarray


class CrossViewConsistencyTest:
    """Views of one sensor as they are read and as they should be: which agree better with each other?"""

    def __init__(self) -> None:
        self.read: list[DepthView] = []
        self.corrected: list[DepthView] = []

    def add(self, depth: Tensor, corrected: Tensor, T_world_camera: np.ndarray) -> None:
        self.read.append(DepthView(depth.cpu().numpy(), T_world_camera))
        self.corrected.append(DepthView(corrected.cpu().numpy(), T_world_camera))

    def improved_fraction(self, camera: Camera, seed: int) -> float | None:
        """Share of the views that agree better with the others once all are corrected; None if too few can tell."""
        rng = np.random.default_rng(seed)
        gains = []
        for view in range(len(self.read)):
            pixels = np.flatnonzero((self.read[view].depth > 0) & (self.corrected[view].depth > 0))
            pixels = rng.choice(pixels, min(PIXELS, len(pixels)), replace=False)
            before, seen = cross_view_residual(camera, self.read, view, pixels)
            after, seen_after = cross_view_residual(camera, self.corrected, view, pixels)
            told = np.minimum(seen, seen_after) >= MIN_OBSERVING_VIEWS
            if told.sum() >= MIN_MEASUREMENTS:
                gains.append(np.log((before[told] + NEAR_M) / (after[told] + NEAR_M)).mean())
        return float(np.mean(np.array(gains) > 0)) if len(gains) >= MIN_VIEWS else None
