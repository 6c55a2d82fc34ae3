"""Settings of the confidence networks of `nice-slam-pre`."""

from __future__ import annotations

from pydantic import Field

from .base import Strict


class ConfidenceConfig(Strict):
    """Which networks judge the readings."""

    files: tuple[str, ...] = Field(
        (), description="Networks of `uncle pretrain confidence`, a sensor each; those of other sensors: the package's."
    )
