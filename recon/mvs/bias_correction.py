"""Bias correction of all sensors: fit to photometric depth, validation, and application to frames."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import UncertaintyConfig
from ..core.frame import Frame
from .bias_model import BiasModel
from .bias_validation import CONSISTENCY_TEST, ConsistencyTestParameters, CrossViewConsistencyTest, Validation
from .photometric_samples import PhotometricSamples


@dataclass(frozen=True)
class PosedView:
    """A frame with its noise model inputs (H, W, F) by sensor and its pose T_world_camera (4, 4)."""

    frame: Frame
    inputs: Mapping[str, Tensor]
    T_world_camera: np.ndarray


@dataclass(frozen=True)
class BiasFit:
    """Result of a fit.

    improved_fraction: of the tested views, by sensor, for sensors with enough views; activated: sensors whose model
    became active by it; validation: result of the test for the sensor with the highest fraction. An accepted bias also
    validates poses and colour-depth calibration, a rejected one shows that they are wrong.
    """

    improved_fraction: dict[str, float]
    activated: frozenset[str]
    validation: Validation


class BiasCorrection:
    """One `BiasModel` per sensor.

    improved_fraction: of the latest fit. newly_active: the latest fit activated a model, so that measurements have
    moved by a whole bias since they were integrated last.
    """

    def __init__(
        self,
        camera: Camera,
        sensors: tuple[str, ...],
        config: UncertaintyConfig,
        seed: int,
        device: torch.device,
        test: ConsistencyTestParameters = CONSISTENCY_TEST,
    ) -> None:
        self.camera, self.config, self.seed, self.device, self.test = camera, config, seed, device, test
        self.generator = torch.Generator().manual_seed(seed)
        self.models = {sensor: BiasModel(config, self.generator).to(device) for sensor in sensors}
        self.improved_fraction: dict[str, float] = {}
        self.newly_active = False

    def fit(self, samples: PhotometricSamples, views: Iterable[PosedView], voxel_size_m: float) -> BiasFit:
        """Fit the model of each sensor to photometric samples; activate it if the consistency test on `views` accepts
        it and its median exceeds the possible bias of photometric depth."""
        exceeds = {}
        for sensor, model in self.models.items():
            residuals = samples.sensor_residuals(sensor)
            model.learn(residuals, self.config.steps_per_pass, self.generator)
            exceeds[sensor] = model.exceeds_photometric_bias(residuals, voxel_size_m)
        fractions = self._improved_fractions(views)
        active_before = self.active()
        for sensor, model in self.models.items():
            accepted = self.test.result(fractions.get(sensor)) is Validation.ACCEPTED
            model.active.fill_(exceeds[sensor] and accepted)
        activated = frozenset(self.active() - active_before)
        self.improved_fraction, self.newly_active = fractions, bool(activated)
        return BiasFit(fractions, activated, self.test.result(max(fractions.values(), default=None)))

    def correct(self, frame: Frame, inputs: Mapping[str, Tensor]) -> Frame:
        """The frame with the active biases subtracted; the same object if there are none."""
        corrected = {
            sensor: self._corrected_depth(sensor, depth, inputs)
            for sensor, depth in frame.depths.items()
            if self.models[sensor].active
        }
        return replace(frame, depths=frame.depths | corrected) if corrected else frame

    def active(self) -> set[str]:
        """The sensors whose bias is corrected."""
        return {sensor for sensor, model in self.models.items() if model.active}

    def _improved_fractions(self, views: Iterable[PosedView]) -> dict[str, float]:
        tests = {sensor: CrossViewConsistencyTest(self.test) for sensor in self.models}
        for view in views:
            for sensor, depth in view.frame.depths.items():
                tests[sensor].add(depth, self._corrected_depth(sensor, depth, view.inputs), view.T_world_camera)
        fractions = {sensor: test.improved_fraction(self.camera, self.seed) for sensor, test in tests.items()}
        return {sensor: fraction for sensor, fraction in fractions.items() if fraction is not None}

    def _corrected_depth(self, sensor: str, depth: Tensor, inputs: Mapping[str, Tensor]) -> Tensor:
        return self.models[sensor].correct(depth.to(self.device), inputs[sensor].to(self.device))

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {
            "models": {sensor: model.training_state() for sensor, model in self.models.items()},
            "improved_fraction": self.improved_fraction,
            "newly_active": self.newly_active,
            "generator": self.generator.get_state(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state of the same sensors and settings."""
        for sensor, trained in state["models"].items():
            self.models[sensor].load_training_state(trained)
        self.improved_fraction, self.newly_active = dict(state["improved_fraction"]), state["newly_active"]
        self.generator.set_state(state["generator"].cpu())
