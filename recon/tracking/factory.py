"""The tracker that the settings ask for."""

from __future__ import annotations

from collections.abc import Mapping

from ..core.config.map_config import MapConfig
from ..run.frames import RunFrames
from ..sensors.noise_model import NoiseModel
from ..volume.tsdf_volume import TsdfVolume
from .base import GivenPoses, Tracker
from .tracker import AlignTracker


def choose_tracker(
    frames: RunFrames,
    config: MapConfig,
    noise: Mapping[str, NoiseModel] | None = None,
    volume: TsdfVolume | None = None,
) -> Tracker:
    """The tracker that `config` asks for.

    `noise` (by sensor) weighs the depth of each sensor; without it a default error scale does. `volume` is the map that
    grows along with the trajectory; without it the camera is tracked by its images alone.
    """
    if not config.tracking.enabled:
        return GivenPoses()
    models = [noise[sensor] if noise else None for sensor in frames.sensors]
    return AlignTracker(frames.camera, config.tracking, config.seed, models, volume, frames.registration_sigma_px)
