"""Record of how each frame was integrated, so that it can be de-integrated exactly when its pose changes."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...core.se3 import rotation_angle
from ...sensors.noise_model import NoiseModel


@dataclass(frozen=True)
class FusionLogParameters:
    """lever_m: distance at which a rotation is counted as a displacement."""

    lever_m: float = 2.0


@dataclass(frozen=True)
class IntegrationRecord:
    """Pose T_world_camera (4, 4) that a frame was integrated with, number of the snapshot of the noise models, and
    number of blocks of the map at that time."""

    T_world_camera: Tensor
    snapshot: int
    block_count: int


class FusionLog:
    """Integration records by frame index, and the snapshots of the noise models that they share."""

    def __init__(self, parameters: FusionLogParameters = FusionLogParameters()) -> None:
        self.parameters = parameters
        self.records: dict[int, IntegrationRecord] = {}
        self.snapshots: list[dict[str, dict[str, Tensor]]] = []

    def add(self, index: int, T_world_camera: Tensor, noise: Mapping[str, NoiseModel], block_count: int) -> None:
        """Record that a frame is integrated with that pose and those noise models."""
        weights = {sensor: model.state_dict() for sensor, model in noise.items()}
        if not self.snapshots or not _equal(weights, self.snapshots[-1]):
            self.snapshots.append(copy.deepcopy(weights))
        self.records[index] = IntegrationRecord(T_world_camera.clone(), len(self.snapshots) - 1, block_count)

    def noise_models(self, record: IntegrationRecord, current: Mapping[str, NoiseModel]) -> dict[str, NoiseModel]:
        """Copies of the `current` noise models with the weights they had at the time of `record`."""
        models = copy.deepcopy(dict(current))
        for sensor, model in models.items():
            model.load_state_dict(self.snapshots[record.snapshot][sensor])
        return models

    def moved_frames(self, poses: Mapping[int, Tensor], limit_m: float) -> list[int]:
        """Indices of integrated frames whose pose (4, 4) now differs from the recorded one by more than `limit_m`."""
        return [
            index
            for index, record in self.records.items()
            if index in poses and self._displacement(record, poses[index]) > limit_m
        ]

    def corrections(self, poses: Mapping[int, Tensor]) -> dict[int, Tensor]:
        """By frame index, the motion T_new_old (4, 4) in world axes from the recorded pose to that of `poses`."""
        return {
            index: poses[index] @ torch.linalg.inv(record.T_world_camera)
            for index, record in self.records.items()
            if index in poses
        }

    def clear(self) -> None:
        """Drop all records."""
        self.records, self.snapshots = {}, []

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {
            "records": {index: dict(vars(record)) for index, record in self.records.items()},
            "snapshots": self.snapshots,
        }

    def load_state_dict(self, state: dict[str, Any], device: torch.device | str = "cpu") -> None:
        """Continue from a state; tensors go to `device`, that of the map."""
        self.records = {
            index: IntegrationRecord(**{**record, "T_world_camera": record["T_world_camera"].to(device)})
            for index, record in state["records"].items()
        }
        self.snapshots = [
            {
                sensor: {name: values.to(device) for name, values in weights.items()}
                for sensor, weights in models.items()
            }
            for models in state["snapshots"]
        ]

    def _displacement(self, record: IntegrationRecord, T_world_camera: Tensor) -> float:
        """How far points `lever_m` away from the camera move, metres."""
        step = torch.linalg.inv(record.T_world_camera.double()) @ T_world_camera.double()
        angle = float(rotation_angle(step.cpu().numpy()))
        return float(torch.linalg.norm(step[:3, 3])) + self.parameters.lever_m * angle


def _equal(first: dict[str, dict[str, Tensor]], second: dict[str, dict[str, Tensor]]) -> bool:
    return all(torch.equal(values, second[s][name]) for s, state in first.items() for name, values in state.items())
