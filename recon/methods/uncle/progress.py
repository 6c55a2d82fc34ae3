"""How far a reconstruction is, and where its time goes."""

from __future__ import annotations

from dataclasses import dataclass, field

from ...core.timing import Timed


@dataclass(kw_only=True)
class RunProgress(Timed):
    """The last sweep that is planned, the present one, the next position in it, and what was recorded on the way.

    Poses are T_world_camera by frame index, losses (nats) by name.
    """

    last: int
    sweep: int = 0
    position: int = 0
    poses: dict[int, list[list[float]]] = field(default_factory=dict)
    losses: dict[str, list[float]] = field(default_factory=dict)
