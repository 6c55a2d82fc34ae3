"""Noise model of photometric depth, trained on the consistency of its own views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from ..core.camera import Camera
from ..core.config.uncle import UncertaintyConfig
from ..sensors.noise_model import NoiseModel, Residuals
from .multi_view_consistency import ConsistencyParameters, cross_view_residual
from .plane_sweep import PHOTOMETRIC_INPUTS, PlaneSweepView


@dataclass(frozen=True)
class PhotometricNoiseParameters:
    """Training pixels: at most `samples_per_view` of a view, each seen by at least `min_observing_views` others, and at
    least `min_samples` in all."""

    samples_per_view: int = 4000
    min_observing_views: int = 3
    min_samples: int = 4000
    consistency: ConsistencyParameters = field(default_factory=ConsistencyParameters)


def fit_photometric_noise(
    camera: Camera,
    views: Sequence[PlaneSweepView],
    config: UncertaintyConfig,
    seed: int,
    parameters: PhotometricNoiseParameters = PhotometricNoiseParameters(),
) -> tuple[NoiseModel, float] | None:
    """h_w of photometric depth and its final mean negative log-likelihood, nats; None if there are too few samples.

    The residuals are distances between views, not to the map: the map is what photometric depth is to correct.
    """
    generator, rng = torch.Generator().manual_seed(seed), np.random.default_rng(seed)
    noise = NoiseModel(config, generator, PHOTOMETRIC_INPUTS)
    inputs, residuals = [], []
    for row, view in enumerate(views):
        pixels = np.flatnonzero(view.depth)
        pixels = rng.choice(pixels, min(parameters.samples_per_view, len(pixels)), replace=False)
        residual, count = cross_view_residual(camera, views, row, pixels, parameters.consistency)
        observed = count >= parameters.min_observing_views
        inputs.append(view.inputs.reshape(-1, len(PHOTOMETRIC_INPUTS))[pixels[observed]])
        residuals.append(residual[observed])
    if sum(map(len, residuals)) < parameters.min_samples:
        return None
    metres = torch.from_numpy(np.concatenate(residuals)).float()
    samples = Residuals.from_exact_reference(metres, torch.from_numpy(np.concatenate(inputs)))
    return noise, noise.learn(samples, config.steps_per_pass, generator)
