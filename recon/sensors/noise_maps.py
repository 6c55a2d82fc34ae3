"""Trained noise models outside a run: loaded from a file, and applied to any image of the same sensor."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import UncertaintyConfig
from ..core.normals import normals as estimate_normals
from ..core.normals import smooth_depth
from .noise_inputs import SENSOR_INPUTS, pixel_inputs
from .noise_model import NoiseModel
from .noise_prior import NoisePrior


def load_noise_models(path: Path) -> dict[str, NoiseModel]:
    """Noise models by sensor, of a run directory with a finished map or of its `map/noise_model.pt`.

    Raises RunError, ConfigError.
    """
    prior = NoisePrior.load(Path(path))
    models = {}
    for sensor, entry in prior.sensors.items():
        used = tuple(entry["features"])
        config = UncertaintyConfig(
            hidden=entry["hidden"],
            inputs=() if used == SENSOR_INPUTS else used,
            beta_min_m=entry["beta_min_m"],
        )
        models[sensor] = NoiseModel(config, torch.Generator())
    prior.initialise(models)
    return models


def predict_beta(
    model: NoiseModel, depth: Tensor, color: Tensor, camera: Camera, normals: Tensor | None = None
) -> Tensor:
    """Laplace scale beta (H, W) of an image, metres, 0 where there is no measurement.

    depth     (H, W) float32 z-depth in metres, 0 = no measurement
    color     (H, W, 3) uint8 RGB, registered to the depth image
    normals   (H, W, 3) in camera axes, 0 = unknown; None: estimated from `depth`, as `uncle preprocess` does
    """
    if normals is None:
        normals = torch.from_numpy(estimate_normals(smooth_depth(depth.numpy()), camera))
    return model.beta_image(depth, pixel_inputs(depth, normals, color, camera))
