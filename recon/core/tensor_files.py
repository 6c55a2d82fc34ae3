"""Files of plain tensors, read without executing anything that they say."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from .errors import ConfigError, RunError, UncleError
from .files import atomic_path, require_file


def save_tensors(path: Path, state: dict[str, Any]) -> None:
    """`torch.save` of plain tensors and containers, in one piece. Raises RunError."""
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        try:
            torch.save(state, file)
        except RuntimeError as error:  # the archive writer's own complaint hides the file's error, such as a full disk
            raise error.__context__ if isinstance(error.__context__, OSError) else error from None


def read_tensors(
    path: Path, device: torch.device | str = "cpu", also: Sequence[Any] = (), legacy: bool = False
) -> object:
    """Tensors and plain values of a file of `torch.save`, and of the types `also`; never runs code from the file.

    `legacy` allows files of PyTorch before 1.6, which are no archives and have no checksums. Raises OSError,
    pickle.UnpicklingError for other types; another error if it is damaged or takes more memory than it has bytes.
    """
    require_file(path)
    with open(path, "rb") as file:
        is_archive = file.read(4) == b"PK\3\4"
    if is_archive:
        _require_whole_archive(path)
    elif not legacy:
        raise ValueError("it is no archive, as `torch.save` writes it")
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


def _require_whole_archive(path: Path) -> None:
    with zipfile.ZipFile(path) as archive:
        if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
            raise ValueError("PyTorch writes no compressed files")
        if damaged := archive.testzip():  # PyTorch itself reads changed values without a word
            raise ValueError(f"{damaged} has another checksum")


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


@contextmanager
def taking_apart(path: Path) -> Iterator[None]:
    """For the use of what `load_tensors` read: content that is not what this program writes ends in RunError."""
    try:
        yield
    except torch.OutOfMemoryError:
        raise
    except (AttributeError, IndexError, KeyError, RuntimeError, TypeError, ValueError) as error:
        if isinstance(error, UncleError):
            raise
        raise _damaged(path) from error


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
