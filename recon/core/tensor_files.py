"""Files of plain tensors, read without executing anything that they say."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from .errors import ConfigError, RunError
from .files import atomic_path, require_file


def save_tensors(path: Path, state: dict[str, Any]) -> None:
    """`torch.save` of plain tensors and containers, in one piece. Raises RunError."""
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        try:
            torch.save(state, file)
        except RuntimeError as error:  # the archive writer's own complaint hides the file's error, such as a full disk
            raise error.__context__ if isinstance(error.__context__, OSError) else error from None


def read_tensors(path: Path, device: torch.device | str = "cpu", also: Sequence[Any] = ()) -> object:
    """Tensors and plain values of a file of `torch.save`, and of the types `also`; never runs code from the file.

    Raises OSError, pickle.UnpicklingError for other types; another error if it is damaged or takes more memory than it
    has bytes.
    """
    require_file(path)
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                raise ValueError("PyTorch writes no compressed files")
    with torch.serialization.safe_globals(list(also)):
        content: object = torch.load(path, map_location=device, weights_only=True)
    pending = [content]
    while pending:
        value = pending.pop()
        if isinstance(value, dict):
            pending += value.values()
        elif isinstance(value, list | tuple):
            pending += value
        elif isinstance(value, torch.Tensor):
            _require_plain(value)
    return content


def _require_plain(tensor: torch.Tensor) -> None:
    """Raises ValueError for a tensor that names more values than it stores."""
    if tensor.layout != torch.strided or tensor.is_quantized:
        raise ValueError("a tensor is sparse or quantised")
    if tensor.numel() * tensor.element_size() > tensor.untyped_storage().nbytes():
        raise ValueError(f"a tensor of {tuple(tensor.shape)} repeats a few values")


def load_tensors(path: Path, device: torch.device | str = "cpu") -> dict[str, Any]:
    """Read what `save_tensors` wrote; never runs code from the file. Raises RunError."""
    try:
        state = read_tensors(path, device)
    except FileNotFoundError as error:
        raise RunError(f"there is no {path}; run `uncle map` first") from error
    except Exception as error:
        raise _damaged(path) from error
    if not isinstance(state, dict):
        raise _damaged(path)
    return state


def _damaged(path: Path) -> RunError:
    return RunError(f"cannot read {path}: it is damaged; redo it with `uncle map --overwrite`")


@dataclass(frozen=True)
class FileFormat:
    """A kind of tensor file that users name in options and settings.

    mark          what the file says of itself under "format"
    version       of the content; files of another one are refused
    description   what it is, for messages: "a file of `uncle pretrain senfunet`"
    advice        how a user gets one, for messages: "make one with `uncle pretrain senfunet`"
    """

    mark: str
    version: int
    description: str
    advice: str

    def save(self, path: Path, content: dict[str, Any]) -> None:
        """Write plain tensors and containers under this format's mark and version. Raises RunError."""
        save_tensors(path, {"format": self.mark, "version": self.version, **content})

    def load(self, path: Path, label: str) -> dict[str, Any]:
        """The content of a file of this format. Raises ConfigError; the message begins with `label`."""
        try:
            content: object = load_tensors(path)  # whatever a user names
        except RunError as error:
            raise self.error(label) from error
        if not isinstance(content, dict) or content.get("format") != self.mark:
            raise self.error(label)
        version = content.get("version")
        if version != self.version:
            raise ConfigError(
                f"{label}: made by another version of uncle (format {version}, here {self.version}); {self.advice}"
            )
        return content

    def error(self, label: str) -> ConfigError:
        """The error for a file that is not of this format."""
        return ConfigError(f"{label}: not {self.description}, or a damaged one; {self.advice}")
