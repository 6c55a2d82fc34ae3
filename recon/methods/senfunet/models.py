"""Trained networks of a pair of sensors as a file of plain tensors; those that the package brings."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from ...core.errors import ConfigError
from ...core.tensor_files import FileFormat
from .network import FeatureNetwork, WeightingNetwork

FORMAT = FileFormat(
    "uncle senfunet", 1, "a file of `uncle pretrain senfunet`", "make one with `uncle pretrain senfunet`"
)
SHIPPED = Path(__file__).parent / "weights"
STANDS_FOR = {"dense": "psmnet"}  # a simulated sensor -> the real kind whose networks are taken
Network = TypeVar("Network", FeatureNetwork, WeightingNetwork)
STEREO = frozenset({"sgm", "psmnet", "dense", "mvs"})  # sensors whose errors follow what the colour camera sees


@dataclass(frozen=True)
class SenfunetModel:
    """Networks of two `sensors`: features of each by name, and the share of the first; trained at `voxel_size_m`."""

    sensors: tuple[str, str]
    features: dict[str, FeatureNetwork]
    weighting: WeightingNetwork
    voxel_size_m: float

    @staticmethod
    def fresh(sensors: tuple[str, str], voxel_size_m: float, generator: torch.Generator) -> SenfunetModel:
        """Untrained networks. Stereo sensors see colour beside depth, others depth alone."""
        features = {sensor: FeatureNetwork(sensor in STEREO, generator) for sensor in sensors}
        return SenfunetModel(sensors, features, WeightingNetwork(generator), voxel_size_m)

    @staticmethod
    def load(sensors: tuple[str, str], file: Path | str | None = None) -> SenfunetModel:
        """Networks of that pair, in any order: of `file`, else of the package. Raises ConfigError."""
        path = Path(file) if file else _shipped(sensors)
        model = _read(path)
        wanted = {STANDS_FOR.get(sensor, sensor): sensor for sensor in sensors}
        found = tuple(STANDS_FOR.get(sensor, sensor) for sensor in model.sensors)
        if set(wanted) != set(found):
            raise ConfigError(f"{path} is of the sensors {' and '.join(model.sensors)}, not {' and '.join(sensors)}")
        first, second = found
        names = (wanted[first], wanted[second])
        features = {name: model.features[old] for name, old in zip(names, model.sensors, strict=True)}
        return SenfunetModel(names, features, model.weighting, model.voxel_size_m)

    def save(self, path: Path, recipe: dict[str, Any]) -> None:
        """Half-precision weights, and what they were trained with. Raises RunError."""
        features = {sensor: _half(network) for sensor, network in self.features.items()}
        FORMAT.save(
            path,
            {
                "sensors": list(self.sensors), "voxel_size_m": self.voxel_size_m,
                "color": [self.features[sensor].color for sensor in self.sensors], "features": features,
                "weighting": _half(self.weighting), "recipe": recipe,
            },
        )  # fmt: skip

    def to(self, device: torch.device | str) -> SenfunetModel:
        """Move the networks to `device`; returns self."""
        for network in self.networks():
            network.to(device)
        return self

    def networks(self) -> list[nn.Module]:
        """The feature networks in the order of the sensors, then the weighting network."""
        return [*self.features.values(), self.weighting]

    @property
    def digest(self) -> str:
        """Short hash of all weights."""
        content = hashlib.sha256(repr(self.sensors).encode())
        for network in self.networks():
            for values in network.state_dict().values():
                content.update(values.cpu().contiguous().numpy().tobytes())
        return content.hexdigest()[:16]


def shipped_pairs() -> list[str]:
    """Pairs of sensors whose networks the package brings, such as "sl+psmnet"."""
    return sorted(path.stem for path in SHIPPED.glob("*.pt"))


def _shipped(sensors: tuple[str, str]) -> Path:
    kinds = [STANDS_FOR.get(sensor, sensor) for sensor in sensors]
    for name in ("+".join(kinds), "+".join(reversed(kinds))):
        if (SHIPPED / f"{name}.pt").is_file():
            return SHIPPED / f"{name}.pt"
    raise ConfigError(
        f"there are no senfunet networks for {' and '.join(sensors)}, only for {', '.join(shipped_pairs()) or 'none'}; "
        f"train them: `uncle pretrain senfunet DATASET --sensors {' '.join(sensors)} --out FILE`, then "
        "--set senfunet.file=FILE"
    )


def _half(network: nn.Module) -> dict[str, Tensor]:
    return {key: values.detach().cpu().half() for key, values in network.state_dict().items()}


def _read(path: Path) -> SenfunetModel:
    if not path.is_file():
        raise ConfigError(f"senfunet.file: there is no {path}; make it with `uncle pretrain senfunet`")
    state = FORMAT.load(path, str(path))
    try:
        first, second = state["sensors"]
        features = {}
        for sensor, color in zip((first, second), state["color"], strict=True):
            features[sensor] = _filled(FeatureNetwork(bool(color)), state["features"][sensor])
        weighting = _filled(WeightingNetwork(), state["weighting"])
        return SenfunetModel((first, second), features, weighting, float(state["voxel_size_m"]))
    except (KeyError, AttributeError, RuntimeError, ValueError, TypeError) as error:
        raise FORMAT.error(str(path)) from error


def _filled(network: Network, weights: dict[str, Tensor]) -> Network:
    network.load_state_dict({key: values.float() for key, values in weights.items()})
    return network.eval()
