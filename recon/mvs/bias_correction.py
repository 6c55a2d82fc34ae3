"""The biases of all sensors of a map: heard from colour, tried, and taken off."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import UncertaintyConfig
from ..core.frame import Frame
from .bias_model import CONFIRMED, BiasModel, CrossViewConsistencyTest
from .photometric_depth import PhotometricDepth

CONSISTENCY_TEST_VIEWS = 40


class BiasCorrection:
    """`models` by sensor; `confirmed`: share of the views that agree better without its bias, if that can be told."""

    def __init__(
        self, camera: Camera, sensors: tuple[str, ...], config: UncertaintyConfig, seed: int, device: torch.device
    ) -> None:
        self.camera, self.config, self.seed, self.device = camera, config, seed, device
        self.generator = torch.Generator().manual_seed(seed)
        self.models = {sensor: BiasModel(config, self.generator).to(device) for sensor in sensors}
        self.confirmed: dict[str, float] = {}
        self.newly_active = False  # whether some readings moved by a whole bias since the sweep before

    def hear(self, witness: PhotometricDepth, views: Iterable[tuple[Frame, dict[str, Tensor]]]) -> None:
        """Learn from colour where the sensors are biased, and believe it of those that some of its `views`, frame and
        features, confirm, if it is more than colour's own can be.

        A bias that is confirmed tells of colour, too: its poses and calibration are exact.
        """
        exceeds = {}
        for column, (sensor, model) in enumerate(self.models.items()):
            heard = witness.against(column)
            model.learn(heard, self.config.steps_per_pass, self.generator)
            exceeds[sensor] = model.exceeds_photometric_bias(heard, witness.voxel_size_m)
        poses = dict(zip(witness.indices, witness.poses, strict=True))
        trials = {sensor: CrossViewConsistencyTest() for sensor in self.models}
        for frame, features in views:
            for sensor, depth in frame.depths.items():
                corrected = self._correct(sensor, depth, features)
                trials[sensor].add(depth, corrected, poses[frame.index].numpy())
        tried = {sensor: trial.improved_fraction(self.camera, self.seed) for sensor, trial in trials.items()}
        self.confirmed = {sensor: share for sensor, share in tried.items() if share is not None}
        before = self.believed()
        for sensor, model in self.models.items():
            model.believed.fill_(exceeds[sensor] and self.confirmed.get(sensor, 0.0) >= CONFIRMED)
        self.newly_active = bool(self.believed() - before)
        witness.judge(max(self.confirmed.values(), default=None))

    def corrected(self, frame: Frame, features: dict[str, Tensor]) -> Frame:
        """The frame without the biases that are believed."""
        known = [sensor for sensor in frame.depths if self.models[sensor].believed]
        corrected = {sensor: self._correct(sensor, frame.depths[sensor], features) for sensor in known}
        return replace(frame, depths=frame.depths | corrected) if known else frame

    def believed(self) -> set[str]:
        """The sensors whose bias is taken off."""
        return {sensor for sensor, model in self.models.items() if model.believed}

    def _correct(self, sensor: str, depth: Tensor, features: dict[str, Tensor]) -> Tensor:
        return self.models[sensor].correct(depth.to(self.device), features[sensor].to(self.device))

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers."""
        models = {sensor: model.training_state() for sensor, model in self.models.items()}
        told = {"confirmed": self.confirmed, "newly_active": self.newly_active}
        return {"models": models, **told, "generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for sensor, trained in state["models"].items():
            self.models[sensor].load_training_state(trained)
        self.confirmed, self.newly_active = dict(state["confirmed"]), state["newly_active"]
        self.generator.set_state(state["generator"].cpu())
