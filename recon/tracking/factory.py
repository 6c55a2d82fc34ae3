"""The tracker that the settings ask for."""

from __future__ import annotations

from ..core.config.map_config import MapConfig
from ..methods.uncle.mapper import Mapper
from ..run.frames import RunFrames
from .base import GivenPoses, Tracker
from .tracker import AlignTracker


def choose_tracker(frames: RunFrames, config: MapConfig, mapper: Mapper | None) -> Tracker:
    """The tracker that `config` asks for; one without `mapper` has no map to look at."""
    if not config.tracking.enabled:
        return GivenPoses()
    noise = [mapper.noise[s] if mapper else None for s in frames.sensors]
    volume = mapper.volume if mapper else None
    return AlignTracker(frames.camera, config.tracking, config.seed, noise, volume, frames.registration_sigma_px)
