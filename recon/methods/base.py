"""What every method is given, what it returns, and what is checked of the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from ..core.config.map_config import MapConfig
from ..core.errors import DataError
from ..core.events import OnEvent
from ..run.checkpoint import Checkpoint
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.tracking_record import TrackingRecord
from ..sensors.noise_prior import NoisePrior
from ..volume.neural_field import NeuralField

Poses = dict[int, np.ndarray]  # frame index -> T_world_camera (4, 4) float64


@dataclass(frozen=True)
class MapJob:
    """What every method is given: the frames `indices` of a run, and the settings.

    prior   noise models of an earlier run to start from, or None
    """

    run: RunDirectory
    frames: RunFrames
    indices: list[int]
    config: MapConfig
    checkpoint: Checkpoint
    prior: NoisePrior | None
    on_event: OnEvent


@dataclass(frozen=True)
class MapResult:
    """What every method returns.

    field      the map
    poses      T_world_camera (4, 4) of every mapped frame by index
    tracking   status and covariance of the tracked poses; None for given poses
    facts      entries of the manifest, plain JSON values
    """

    field: NeuralField
    poses: Poses
    tracking: TrackingRecord | None
    facts: dict[str, Any]


# (frame index, sensor, beta (H, W) metres): called once for every mapped frame with the final noise models
OnBeta = Callable[[int, str, Tensor], None]


def require_surface(field: NeuralField) -> None:
    """Raises DataError if no sample of the map was observed often enough."""
    if not bool(field.known.any()):
        raise DataError(
            "nothing was seen often enough to make a surface; map more frames or lower fusion.min_observations"
        )


def rounded_seconds(seconds: dict[str, float]) -> dict[str, float]:
    """Seconds of each part of the work, as the manifest records them."""
    return {name: round(value, 2) for name, value in seconds.items()}
