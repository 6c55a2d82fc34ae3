"""Worlds far from their origin, such as map coordinates (UTM): an offset that keeps coordinates small.

In single precision a coordinate of 500 km is exact to 3 cm, one of 300 m to 0.03 mm. Everything in a run is therefore
relative to an offset; files that leave it are in the world of the data set again.
"""

from __future__ import annotations

import numpy as np

from .number_format import format_grouped

FAR_M = 300.0  # worlds nearer to their origin are taken as they are
_STEP_M = 10.0  # offsets are whole multiples
NO_OFFSET = (0.0, 0.0, 0.0)

Offset = tuple[float, float, float]


def world_offset(positions: np.ndarray) -> Offset:
    """The offset (3,) metres to subtract from points (N, 3): near their median, or 0 where that is near 0."""
    finite = positions[np.isfinite(positions).all(1)]
    if not len(finite):
        return NO_OFFSET
    median = np.median(finite.astype(np.float64), axis=0)
    if np.linalg.norm(median) <= FAR_M:
        return NO_OFFSET
    x, y, z = (np.round(median / _STEP_M) * _STEP_M).tolist()
    return (x, y, z)


def describe_offset(offset: Offset) -> str:
    """One line for the user."""
    place = ", ".join(format_grouped(round(value)) for value in offset)
    return f"the world lies far from its origin: inside the run, coordinates are relative to ({place}) m"
