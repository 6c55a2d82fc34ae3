"""State of an unfinished map on disk, so that an interrupted run can continue."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from ..core.tensor_files import load_tensors, save_tensors

VERSION = 8  # of the states; to be increased when those of the version before can no longer be continued


class Checkpoint:
    """Saves a state at most every `interval_s` seconds; ignores one of other settings or versions, which is redone."""

    def __init__(self, path: Path, config_hash: str, interval_s: float = 30.0) -> None:
        self.path, self.config_hash, self.interval_s = path, config_hash, interval_s
        self._last = time.monotonic()

    def due(self) -> bool:
        """Whether enough time went by since the last save."""
        return time.monotonic() - self._last >= self.interval_s

    def save(self, state: dict[str, Any]) -> None:
        """Write the state. Raises RunError."""
        save_tensors(self.path, {"version": VERSION, "config_hash": self.config_hash, **state})
        self._last = time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """The saved state, or None if there is none of these settings and this version. Raises RunError."""
        if not self.path.exists():
            return None
        state = load_tensors(self.path)
        return state if (state.get("version"), state["config_hash"]) == (VERSION, self.config_hash) else None

    def remove(self) -> None:
        """Delete the state."""
        self.path.unlink(missing_ok=True)
