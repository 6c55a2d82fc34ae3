"""What was fused from where and with which noise models, so that a frame can be taken out when its camera moves."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...sensors.noise_model import NoiseModel

LEVER_M = 2.0  # a turn moves what is this far away


@dataclass(frozen=True)
class Entry:
    """T_world_camera (4, 4) that a frame was fused from; which snapshot of the models; how many blocks the map had."""

    T_world_camera: Tensor
    snapshot: int
    blocks: int


class FusionLog:
    """Entries by frame index, and the snapshots of the noise models that they share."""

    def __init__(self) -> None:
        self.entries: dict[int, Entry] = {}
        self.snapshots: list[dict[str, dict[str, Tensor]]] = []

    def note(self, index: int, T_world_camera: Tensor, noise: dict[str, NoiseModel], blocks: int) -> None:
        """Remember how a frame is about to be fused."""
        now = {sensor: model.state_dict() for sensor, model in noise.items()}
        if not self.snapshots or not _same(now, self.snapshots[-1]):
            self.snapshots.append(copy.deepcopy(now))
        self.entries[index] = Entry(T_world_camera.clone(), len(self.snapshots) - 1, blocks)

    def models(self, entry: Entry, like: dict[str, NoiseModel]) -> dict[str, NoiseModel]:
        """The noise models as they were then."""
        models = copy.deepcopy(like)
        for sensor, model in models.items():
            model.load_state_dict(self.snapshots[entry.snapshot][sensor])
        return models

    def moved(self, poses: dict[int, Tensor], limit_m: float) -> list[int]:
        """Indices of the fused frames whose camera (4, 4) is no longer where it was, by more than `limit_m`."""
        return [i for i, entry in self.entries.items() if i in poses and _distance(entry, poses[i]) > limit_m]

    def clear(self) -> None:
        self.entries, self.snapshots = {}, []

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers."""
        return {"entries": {i: tuple(vars(e).values()) for i, e in self.entries.items()}, "snapshots": self.snapshots}

    def load_state_dict(self, state: dict[str, Any], device: torch.device | str = "cpu") -> None:
        """`device`: that of the map, which poses and models are compared on."""
        self.entries = {i: Entry(T.to(device), *others) for i, (T, *others) in state["entries"].items()}
        self.snapshots = [
            {
                sensor: {name: values.to(device) for name, values in weights.items()}
                for sensor, weights in models.items()
            }
            for models in state["snapshots"]
        ]


def _distance(entry: Entry, T_world_camera: Tensor) -> float:
    """How far what the camera sees has moved, metres."""
    step = torch.linalg.inv(entry.T_world_camera.double()) @ T_world_camera.double()
    turn = torch.arccos(((torch.trace(step[:3, :3]) - 1) / 2).clamp(-1, 1))
    return float(torch.linalg.norm(step[:3, 3]) + LEVER_M * turn)


def _same(first: dict[str, dict[str, Tensor]], second: dict[str, dict[str, Tensor]]) -> bool:
    return all(torch.equal(values, second[s][name]) for s, state in first.items() for name, values in state.items())
