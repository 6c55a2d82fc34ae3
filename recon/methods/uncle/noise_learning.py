"""Training of the noise models on residuals of keyframe rays against the map.

In the online pass the map does not hold the rays of a new keyframe yet. After a pass it holds all of them, so that the
residual of a measurement must be taken against the map without this measurement (leave-one-out).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from ...core.config.uncle import UncertaintyConfig
from ...mvs.bias_model import BiasModel
from ...mvs.photometric_samples import PhotometricSamples
from ...sensors.error_quantiles import fit_error_quantiles
from ...sensors.fusion_weights import FusionWeights
from ...sensors.noise_model import NoiseModel, Residuals
from ...volume.tsdf_volume import TsdfVolume
from .ray_buffer import Rays

# What the scale beta is to describe: the error of the measurement as recorded, or of the bias-corrected one.
Target = Literal["raw", "corrected"]


@dataclass(frozen=True)
class NoiseLearningParameters:
    """max_weight_ratio: measurements that make up more of the map than this have no usable leave-one-out residual."""

    max_weight_ratio: float = 0.9


@dataclass(frozen=True)
class MapResiduals:
    """Residuals of one sensor at N rays that hit the surface.

    corrected (N,): bias-corrected depth minus depth of the map, metres; bias (N,): what was subtracted, metres;
    inputs (N, F) of the noise model; points (N, 3): where the rays hit the surface, world.
    """

    corrected: Tensor
    bias: Tensor
    inputs: Tensor
    points: Tensor

    def to_target(self, target: Target) -> Residuals:
        """Residuals to fit the noise model to."""
        metres = self.corrected + self.bias if target == "raw" else self.corrected
        return Residuals.from_exact_reference(metres, self.inputs)


def map_residuals(rays: Rays, sensor: str, map_depth: Tensor, bias: BiasModel) -> MapResiduals:
    """Residuals of a sensor where it measured and the map has a surface; map_depth (N,) metres, 0 = no surface."""
    depth, inputs = rays.measured_by(sensor)
    used = (depth > 0) & (map_depth > 0)
    inputs = inputs[used]
    offset = torch.zeros_like(depth[used]) + bias.offset(inputs.float())
    residual = depth[used] - offset - map_depth[used]
    points = rays.origins[used] + rays.directions[used] * map_depth[used, None]
    return MapResiduals(residual, offset, inputs, points)


@torch.no_grad()
def leave_one_out(
    residuals: MapResiduals,
    weights: Tensor,
    volume: TsdfVolume,
    parameters: NoiseLearningParameters = NoiseLearningParameters(),
) -> MapResiduals:
    """The residuals against the map without the measurement itself, where they can be known.

    The map is a weighted mean, so leaving one measurement of fusion weight w (`weights` (N,)) out of the total W at its
    point scales its residual by 1 / (1 - w / W).
    """
    rows = volume.grid.nearest_rows(residuals.points)
    total = volume.sums[rows.clamp(min=0), 0]
    ratio = (weights / total.clamp(min=1e-9)).clamp(max=1.0)
    # A measurement farther away than the truncation did not contribute to the distance at this point.
    contributed = residuals.corrected.abs() < volume.truncation_m
    scaled = residuals.corrected / (1 - ratio.clamp(max=parameters.max_weight_ratio))
    corrected = torch.where(contributed, scaled, residuals.corrected)
    known = ~contributed | (ratio < parameters.max_weight_ratio)
    return MapResiduals(corrected[known], residuals.bias[known], residuals.inputs[known], residuals.points[known])


class NoiseLearner:
    """The noise model of each sensor, its training, and the error quantiles of the finished map.

    error_quantiles: by sensor and per cent, in units of beta.
    """

    def __init__(
        self,
        sensors: tuple[str, ...],
        config: UncertaintyConfig,
        generator: torch.Generator,
        device: torch.device,
        parameters: NoiseLearningParameters = NoiseLearningParameters(),
    ) -> None:
        self.config, self.generator, self.parameters = config, generator, parameters
        self.models = {sensor: NoiseModel(config, generator).to(device) for sensor in sensors}
        self.error_quantiles: dict[str, dict[str, float]] = {}

    def learn_online(self, rays: Rays, map_depth: Tensor, biases: Mapping[str, BiasModel]) -> None:
        """Train on rays of a new keyframe that the map does not hold yet; map_depth (N,) is its depth along them."""
        for sensor, model in self.models.items():
            residuals = map_residuals(rays, sensor, map_depth, biases[sensor]).to_target("corrected")
            model.learn(residuals, self.config.steps_per_keyframe, self.generator)

    def learn_from_map(self, evidence: MapEvidence, target: Target) -> dict[str, float]:
        """Train on all keyframe rays, which the map holds, and on photometric samples.

        Returns the mean negative log-likelihood by sensor, nats. With the target "raw" the objective is that of
        calibrated quantiles, and the error quantiles are fitted, too.
        """
        raw, losses = target == "raw", {}
        for sensor, model in self.models.items():
            residuals = self._leave_one_out_residuals(sensor, evidence).to_target(target)
            training = residuals
            if evidence.samples is not None:
                bias = None if raw else evidence.biases[sensor]
                training = residuals.concatenate(evidence.samples.sensor_residuals(sensor, bias))
            losses[sensor] = model.learn(training, self.config.steps_per_pass, self.generator, quantile_objective=raw)
            if raw:
                self.error_quantiles[sensor] = fit_error_quantiles(model.normalised(residuals))
        return losses

    def _leave_one_out_residuals(self, sensor: str, evidence: MapEvidence) -> MapResiduals:
        residuals = map_residuals(evidence.rays, sensor, evidence.map_depth, evidence.biases[sensor])
        weights = evidence.weights.inverse_variance(self.models[sensor](residuals.inputs.float()), sensor)
        return leave_one_out(residuals, weights, evidence.volume, self.parameters)

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from; without the shared generator."""
        models = {sensor: model.training_state() for sensor, model in self.models.items()}
        return {"models": models, "error_quantiles": self.error_quantiles}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state of the same sensors and settings."""
        for sensor, trained in state["models"].items():
            self.models[sensor].load_training_state(trained)
        self.error_quantiles = dict(state["error_quantiles"])


@dataclass(frozen=True)
class MapEvidence:
    """What noise models are trained on after a pass.

    rays: of the keyframes; map_depth (N,): depth of the map along them, metres, 0 = no surface; volume and weights: the
    map and the fusion weights it was made with; biases: by sensor; samples: of photometric depth, if there are any.
    """

    rays: Rays
    map_depth: Tensor
    volume: TsdfVolume
    weights: FusionWeights
    biases: Mapping[str, BiasModel]
    samples: PhotometricSamples | None
