"""Trained confidence networks as files of plain tensors, one sensor each; those that the package brings."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ...core.errors import ConfigError
from ...core.tensor_files import FileFormat
from .network import ConfidenceNetwork, channels_last, confidence_image

FORMAT = FileFormat(
    "uncle confidence network", 1, "a file of `uncle pretrain confidence`", "make one with `uncle pretrain confidence`"
)
SHIPPED = Path(__file__).parent / "weights"
STANDS_FOR = {"dense": "psmnet"}  # a simulated sensor -> the real kind whose network is taken


def save_network(path: Path, sensor: str, network: ConfidenceNetwork, recipe: dict[str, Any]) -> None:
    """Half-precision weights with the name of their sensor and what they were trained with. Raises RunError."""
    weights = {key: values.detach().cpu().half() for key, values in network.state_dict().items()}
    FORMAT.save(path, {"sensor": sensor, "weights": weights, "recipe": recipe})


@dataclass(frozen=True)
class ConfidenceModels:
    """One network by sensor."""

    networks: dict[str, ConfidenceNetwork]

    @staticmethod
    def load(
        sensors: Iterable[str], files: Iterable[Path | str] = (), device: torch.device | str = "cpu"
    ) -> ConfidenceModels:
        """Networks of `sensors`: those of `files`, else of the package. Raises ConfigError naming what is missing."""
        given = dict(_read(Path(file)) for file in files)
        return ConfidenceModels({sensor: _network_of(sensor, given).to(device) for sensor in sensors})

    def image(self, sensor: str, depth: Tensor) -> Tensor:
        """depth (H, W) metres -> (H, W) confidence 0..1 of its measurements, 0 where there is none."""
        return confidence_image(self.networks[sensor], depth)

    @property
    def digest(self) -> str:
        """Short hash of all weights."""
        content = hashlib.sha256()
        for sensor, network in sorted(self.networks.items()):
            content.update(sensor.encode())
            for values in network.state_dict().values():
                content.update(values.cpu().contiguous().numpy().tobytes())
        return content.hexdigest()[:16]


def shipped_sensors() -> list[str]:
    """Sensors whose network the package brings."""
    return sorted(path.stem for path in SHIPPED.glob("*.pt"))


def _network_of(sensor: str, given: dict[str, ConfidenceNetwork]) -> ConfidenceNetwork:
    if sensor in given:
        return given[sensor]
    path = SHIPPED / f"{STANDS_FOR.get(sensor, sensor)}.pt"
    if not path.is_file():
        raise ConfigError(
            f"there is no confidence network for the sensor {sensor!r}, only for "
            f"{', '.join(shipped_sensors()) or 'none'}; train one: "
            f"`uncle pretrain confidence DATASET --sensor {sensor} --out FILE`, then "
            f"--set 'confidence.files=[\"FILE\"]'"
        )
    return _read(path)[1]


def _read(path: Path) -> tuple[str, ConfidenceNetwork]:
    """Sensor and network of a file. Raises ConfigError."""
    if not path.is_file():
        raise ConfigError(f"confidence.files: there is no {path}; make it with `uncle pretrain confidence`")
    state = FORMAT.load(path, str(path))
    network = ConfidenceNetwork()
    try:
        network.load_state_dict({key: values.float() for key, values in state["weights"].items()})
    except (KeyError, AttributeError, RuntimeError, TypeError, ValueError) as error:
        raise FORMAT.error(str(path)) from error
    return str(state.get("sensor")), channels_last(network).eval()
