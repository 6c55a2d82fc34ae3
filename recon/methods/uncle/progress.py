"""How far a reconstruction is, and where its time goes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass(kw_only=True)
class Timed:
    """Seconds that were spent, by part."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def timed(self, part: str) -> Iterator[None]:
        """Adds the seconds of a block to those of `part`."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began


@dataclass(kw_only=True)
class Progression(Timed):
    """The last sweep that is planned, the present one, the next position in it, and what was recorded on the way.

    Poses are T_world_camera by frame index, losses (nats) by name.
    """

    last: int
    sweep: int = 0
    position: int = 0
    poses: dict[int, list[list[float]]] = field(default_factory=dict)
    losses: dict[str, list[float]] = field(default_factory=dict)
