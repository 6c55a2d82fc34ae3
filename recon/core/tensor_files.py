"""Files of plain tensors, read without executing anything that they say."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from .errors import ConfigError, RunError
from .files import atomic_path


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
        state: dict[str, Any] = torch.load(path, map_location=device, weights_only=True)
    except FileNotFoundError as error:
        raise RunError(f"there is no {path}; run `uncle map` first") from error
    except Exception as error:
        raise RunError(f"cannot read {path}: it is damaged; redo it with `uncle map --overwrite`") from error
    return state


def load_versioned(path: Path, called: str, what: str, format: str, version: int, again: str) -> dict[str, Any]:
    """What a file that a user names holds, if it is of the right `format` and `version`.

    Raises ConfigError that begins with what the file is `called` and says that it is not `what`, or to make it `again`.
    """
    wrong = f"{called}: not {what}"
    try:
        state: object = load_tensors(path)  # whatever a user names
    except RunError as error:
        raise ConfigError(wrong) from error
    if not isinstance(state, dict) or state.get("format") != format:
        raise ConfigError(wrong)
    if state.get("version") != version:
        raise ConfigError(f"{called}: version {state.get('version')}, here {version}; {again}")
    return state
