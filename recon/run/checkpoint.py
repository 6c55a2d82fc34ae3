"""State of an unfinished map on disk, so that a broken run can go on."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import torch

from ..core.errors import ConfigError, RunError
from ..core.files import atomic_path


def save_tensors(path: Path, state: dict[str, Any]) -> None:
    """`torch.save` of plain tensors and containers, in one piece. Raises RunError."""
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        try:
            torch.save(state, file)
        except RuntimeError as error:  # the archive writer's own complaint hides the file's error, such as a full disk
            raise error.__context__ if isinstance(error.__context__, OSError) else error from None


def load_tensors(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read what `save_tensors` wrote; never runs code from the file. Raises RunError."""
    try:
        return torch.load(path, map_location=device, weights_only=True)
    except FileNotFoundError as error:
        raise RunError(f"there is no {path}; run `uncle map` first") from error
    except Exception as error:
        raise RunError(f"cannot read {path}: it is damaged; redo it with `uncle map --overwrite`") from error


def load_versioned(path: Path, called: str, what: str, format: str, version: int, again: str) -> dict[str, Any]:
    """What a file that a user names holds, if it is of the right `format` and `version`.

    Raises ConfigError that begins with what the file is `called` and says that it is not `what`, or to make it `again`.
    """
    wrong = f"{called}: not {what}"
    try:
        state = load_tensors(path)
    except RunError as error:
        raise ConfigError(wrong) from error
    if not isinstance(state, dict) or state.get("format") != format:
        raise ConfigError(wrong)
    if state.get("version") != version:
        raise ConfigError(f"{called}: version {state.get('version')}, here {version}; {again}")
    return state


VERSION = 4  # of what states hold; to be counted up when a program can no longer continue those of the one before


class Checkpoint:
    """Saves a state at most every `interval_s` seconds; refuses to continue one of other settings or versions."""

    def __init__(self, path: Path, config_hash: str, interval_s: float = 30.0) -> None:
        self.path, self.config_hash, self.interval_s = path, config_hash, interval_s
        self._last = time.monotonic()

    def due(self) -> bool:
        """Whether enough time went by since the last save."""
        return time.monotonic() - self._last >= self.interval_s

    def save(self, state: dict[str, Any]) -> None:
        """Raises RunError."""
        save_tensors(self.path, {"version": VERSION, "config_hash": self.config_hash, **state})
        self._last = time.monotonic()

    def load(self) -> dict[str, Any] | None:
        """The saved state, or None if there is none for these settings."""
        if not self.path.exists():
            return None
        state = load_tensors(self.path)
        return state if (state.get("version"), state["config_hash"]) == (VERSION, self.config_hash) else None

    def remove(self) -> None:
        """Forget the state."""
        self.path.unlink(missing_ok=True)
