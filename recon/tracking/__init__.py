"""T_world_camera of every frame.

Imports sensors and the rooms below it (core, run, volume), never mvs. Start at `base.py` (what a tracker offers) and
`tracker.py` (the tracker of `--track`).
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .base import GivenPoses, Tracker
    from .factory import choose_tracker

__all__ = [
    "GivenPoses",
    "Tracker",
    "choose_tracker",
]

__getattr__ = lazy_names(
    __name__,
    {
        **dict.fromkeys(("GivenPoses", "Tracker"), ".base"),
        "choose_tracker": ".factory",
    },
)
