"""Noise models of a finished recording as a file, and as the prior of the next recording with the same sensors."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ..core.config.uncle import UncertaintyConfig
from ..core.errors import ConfigError, RunError
from ..core.tensor_files import FileFormat
from ..run.directory import RunDirectory
from .noise_inputs import SENSOR_INPUTS
from .noise_model import NoiseModel

FORMAT = FileFormat(
    "uncle noise models", 1, "a file of noise models",
    "give a run directory that `uncle map` filled, or its map/noise_model.pt",
)  # fmt: skip
SHAPE = ("hidden", "inputs", "features", "beta_min_m")  # of a model: inputs it was made for, and those it uses


def save_noise_models(path: Path, noise: dict[str, NoiseModel]) -> None:
    """Write the trained models by sensor, with their shapes. Raises RunError."""
    sensors = {
        name: {
            "weights": {key: values.detach().cpu() for key, values in model.state_dict().items()},
            "hidden": model.config.hidden,
            "inputs": list(SENSOR_INPUTS),
            "features": model.used_inputs,
            "beta_min_m": model.config.beta_min_m,
        }
        for name, model in noise.items()
        if model.is_trained
    }
    FORMAT.save(path, {"sensors": sensors})


@dataclass(frozen=True)
class NoisePrior:
    """Noise models by sensor name, as `save_noise_models` wrote them to `path`; each with its weights and its shape."""

    path: Path
    sensors: dict[str, dict[str, Any]]

    @staticmethod
    def load(path: Path) -> NoisePrior:
        """Read a file, or that of the map of a run directory. Raises RunError, ConfigError."""
        if path.is_dir():
            run = RunDirectory(path)
            run.require_stage("map")
            path = run.noise_model_path
            if not path.is_file():
                raise RunError(
                    f"the map of {run.root} holds no noise models; make it with `uncle map --method uncle --overwrite`"
                )
        elif not path.exists():
            raise ConfigError(f"--prior {path}: there is no such file; give a run directory, or its noise_model.pt")
        return NoisePrior(path, _read(path))

    @property
    def digest(self) -> str:
        """Short hash of the models, wherever the file is."""
        content = hashlib.sha256()
        for name, entry in sorted(self.sensors.items()):
            content.update(repr((name, *(entry[key] for key in SHAPE))).encode())
            for key, values in sorted(entry["weights"].items()):
                content.update(repr((key, tuple(values.shape), values.dtype)).encode())
                content.update(values.contiguous().numpy().tobytes())
        return content.hexdigest()[:16]

    def covers(self, sensors: Iterable[str]) -> list[str]:
        """Those of `sensors` that it has a model for. Raises ConfigError if there is none."""
        covered = [sensor for sensor in sensors if sensor in self.sensors]
        if not covered:
            raise ConfigError(
                f"--prior {self.path} has a model of none of the sensors {', '.join(sensors)}, only of "
                f"{', '.join(self.sensors) or 'none'}; leave --prior out"
            )
        return covered

    def require_fit(self, sensors: Iterable[str], config: UncertaintyConfig) -> None:
        """Raises ConfigError if a model of `sensors` cannot start one of these settings."""
        for sensor in sensors:
            self._start(sensor, NoiseModel(config, torch.Generator()))

    def initialise(self, noise: dict[str, NoiseModel]) -> None:
        """Let the models of the sensors that it covers start from it. Raises ConfigError."""
        for sensor, model in noise.items():
            if sensor in self.sensors:
                self._start(sensor, model)

    def _start(self, sensor: str, model: NoiseModel) -> None:
        entry = self.sensors[sensor]
        where = f"--prior {self.path}, sensor {sensor}"
        if entry["inputs"] != list(SENSOR_INPUTS):
            other = sorted(set(entry["inputs"]) ^ set(SENSOR_INPUTS))
            raise ConfigError(
                f"{where}: made for other inputs ({', '.join(other) or 'in another order'}), by another version; "
                "map that recording again with this one"
            )
        if entry["features"] != model.used_inputs:
            setting = json.dumps(entry["features"])
            raise ConfigError(f"{where}: it uses other inputs; add --set 'uncertainty.inputs={setting}'")
        if entry["hidden"] != model.config.hidden:
            raise ConfigError(
                f"{where}: its layers are {entry['hidden']} wide, here {model.config.hidden}; "
                f"add --set uncertainty.hidden={entry['hidden']}"
            )
        try:
            model.initialise_from_prior(entry["weights"])
        except RuntimeError as error:
            raise ConfigError(
                f"{where}: a network of another shape, by another version; map that recording again with this one"
            ) from error


def _read(path: Path) -> dict[str, dict[str, Any]]:
    label = f"--prior {path}"
    sensors = FORMAT.load(path, label).get("sensors")
    if not isinstance(sensors, dict) or not all(_is_entry(entry) for entry in sensors.values()):
        raise FORMAT.error(label)
    return sensors


def _is_entry(entry: Any) -> bool:
    if not isinstance(entry, dict) or not {"weights", *SHAPE} <= entry.keys():
        return False
    weights = entry["weights"]
    return isinstance(weights, dict) and all(isinstance(values, torch.Tensor) for values in weights.values())
