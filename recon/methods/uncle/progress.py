"""Progress of a reconstruction: passes, poses, losses, and seconds by part."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ...core.timing import Timed


@dataclass(kw_only=True)
class RunProgress(Timed):
    """The current pass (0 is the online pass), the last one planned, and the next position in the current one.

    poses: T_world_camera by frame index; losses: nats by name; seconds: by part.
    """

    last_pass: int = 0
    current_pass: int = 0
    position: int = 0
    poses: dict[int, list[list[float]]] = field(default_factory=dict)
    losses: dict[str, list[float]] = field(default_factory=dict)

    @property
    def is_last_pass(self) -> bool:
        """Whether no pass is planned after the current one."""
        return self.current_pass == self.last_pass

    def add_loss(self, name: str, loss: float) -> None:
        """Append to the losses of that name."""
        self.losses.setdefault(name, []).append(loss)

    def start_next_pass(self) -> None:
        """Begin at the first frame of the next pass."""
        self.current_pass, self.position = self.current_pass + 1, 0

    def state_dict(self) -> dict[str, Any]:
        """Plain containers that `load_state_dict` continues from."""
        return dict(vars(self))

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        vars(self).update(state)
