"""How far a reconstruction is, and where its time goes."""

from __future__ import annotations

import time
from dataclasses import dataclass, field


@dataclass
class Progression:
    """The sweep, the last one that is planned, the next position in the sweep, and what was recorded on the way.

    Poses are T_world_camera by frame index, losses (nats) by name, seconds by part.
    """

    sweep: int = 0
    last: int = 0
    position: int = 0
    poses: dict[int, list[list[float]]] = field(default_factory=dict)
    losses: dict[str, list[float]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


class timed:
    """Adds the seconds of a block to `progress.seconds[name]`."""

    def __init__(self, progress: Progression, name: str) -> None:
        self.progress, self.name = progress, name

    def __enter__(self) -> None:
        self.started = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        spent = time.perf_counter() - self.started
        self.progress.seconds[self.name] = self.progress.seconds.get(self.name, 0.0) + spent
