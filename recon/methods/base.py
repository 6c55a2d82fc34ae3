"""What every method is given and what it returns."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from torch import Tensor

from ..core.config.map_config import MapConfig
from ..core.events import OnEvent
from ..run.checkpoint import Checkpoint
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.tracking_record import TrackingRecord
from ..sensors.noise_prior import NoisePrior
from ..volume.neural_field import NeuralField


@dataclass(frozen=True)
class MapJob:
    """What every method is given: the frames `indices` of a run, and the settings."""

    run: RunDirectory
    frames: RunFrames
    indices: list[int]
    config: MapConfig
    checkpoint: Checkpoint
    prior: NoisePrior | None
    on_event: OnEvent


@dataclass(frozen=True)
class MapResult:
    """What every method returns: the field, T_world_camera by frame index, how sure the poses are if they were
    tracked, and facts for the manifest."""

    field: NeuralField
    poses: dict[int, np.ndarray]
    tracking: TrackingRecord | None
    facts: dict[str, Any]


# (frame index, sensor, beta (H, W) metres): called once for every mapped frame with the final noise models
OnBeta = Callable[[int, str, Tensor], None]
