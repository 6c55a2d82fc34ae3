"""Settings of the baseline `senfunet`; voxel size, truncation and range are those of `fusion`."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from .base import Strict


class SenfunetConfig(Strict):
    """The learned fusion of two sensors."""

    file: str = Field(
        "", description="File of `uncle pretrain senfunet` for the two sensors; empty: that of the package."
    )
    outlier_filter: bool = Field(
        True, description="Remove surfaces that only one sensor observed where its weight is below one half."
    )


PRESET: dict[str, dict[str, Any]] = {
    "fusion": {"passes": 0, "truncation_voxels": 5.0, "min_observations": 1.0},
    "uncertainty": {"enabled": False},
    "photometric": {"enabled": False},
    "field": {"iterations": 0},
}
