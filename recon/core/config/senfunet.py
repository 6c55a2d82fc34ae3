"""Settings of the baseline `senfunet`; voxel size, truncation and range are those of `fusion`."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from .base import Strict


class SenfunetConfig(Strict):
    """The learned fusion of two sensors."""

    file: str = Field(
        "", description="Networks of the two sensors, a file of `uncle pretrain senfunet`; empty: those of the package."
    )
    outlier_filter: bool = Field(
        True, description="Leave out what one sensor alone reads where its own weight is less than half."
    )


PRESET: dict[str, dict[str, Any]] = {
    "fusion": {"passes": 0, "truncation_voxels": 5.0, "min_observations": 1.0},
    "uncertainty": {"enabled": False},
    "photometric": {"enabled": False},
    "field": {"iterations": 0},
}
