"""Which trained networks a map of feature grids depends on."""

from __future__ import annotations

from ...core.config.map_config import MapConfig
from ..confidence.models import ConfidenceModels
from .scene import choose_decoders


def digests(config: MapConfig) -> list[str]:
    """Of the occupancy decoders, and of the confidence networks where they weigh depth. Raises ConfigError."""
    parts = [choose_decoders(config.nice.decoders).digest]
    if config.nice.weighting == "confidence":
        parts.append(ConfidenceModels.load(config.sensors, config.confidence.files).digest)
    return parts
