"""SenFuNet as the registry runs it: the networks of the chosen sensors, and the fusion with them."""

from __future__ import annotations

from ...core.config.map_config import MapConfig
from ...core.device import choose_device
from ...core.events import OnEvent
from ...run.frames import RunFrames
from ...volume.neural_field import NeuralField
from ..base import Poses
from .fuse import fuse_senfunet
from .models import SenfunetModel


def fuse(
    frames: RunFrames, indices: list[int], config: MapConfig, on_event: OnEvent, poses: Poses | None
) -> tuple[NeuralField, Poses]:
    """Fuse one or two sensors at `poses`, or at those of the recording. Raises ConfigError without networks."""
    return fuse_senfunet(frames, indices, config, _model(config), choose_device(config.device), on_event, poses)


def trained_digests(config: MapConfig) -> list[str]:
    """Of the networks of the pair of sensors; none for a single one. Raises ConfigError."""
    model = _model(config)
    return [model.digest] if model else []


def _model(config: MapConfig) -> SenfunetModel | None:
    if len(config.sensors) < 2:
        return None
    first, second = config.sensors
    return SenfunetModel.load((first, second), config.senfunet.file or None)
