"""Settings of the confidence networks of `nice-slam-pre`."""

from __future__ import annotations

from pydantic import Field

from .base import Strict


class ConfidenceConfig(Strict):
    """The confidence networks of the sensors."""

    files: tuple[str, ...] = Field(
        (), description="Files of `uncle pretrain confidence`, one per sensor; other sensors use those of the package."
    )
