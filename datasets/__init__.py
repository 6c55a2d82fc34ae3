"""Readers of recorded sequences: each turns files on disk into `Frame` values."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from ..recon.core.errors import DataError

if TYPE_CHECKING:  # the readers import torch; whoever only wants the names of the formats should not wait for it
    from .recording import FileRecording

# format -> (module, what its folder looks like). The order is the order of recognition.
_READERS = {
    "folder": ("folder", "camera.json and color/"),
    "senfunet": ("senfunet", "left_rgb/ or 1/left_rgb/"),
    "replica": ("replica", "results/frame*.jpg"),
    "7scenes": ("seven_scenes", "frame-*.color.png or seq-*/"),
    "tum": ("tum", "rgb.txt and depth.txt"),
    "scannet": ("scannet", "frames/color/ and frames/pose/"),
}
FORMATS: tuple[str, ...] = tuple(_READERS)


def open_dataset(path: Path, format: str | None = None) -> FileRecording:
    """Open the recording in the folder `path`; `format` (one of FORMATS) forces a reader.

    Raises DataError if the folder is missing, empty, of no known format, or not what its format promises.
    """
    path = Path(path)
    return _reader(format or recognise(path)).read(_require_folder(path))


def recognise(path: Path) -> str:
    """The name of the format of the folder `path`, from what it contains. Raises DataError."""
    path = _require_folder(Path(path))
    for name in FORMATS:
        if _reader(name).matches(path):
            return name
    looked_for = "; ".join(f"{name}: {layout}" for name, (_, layout) in _READERS.items())
    raise DataError(
        f"cannot tell the format of {path}; looked for {looked_for}. Name it with --format, or see docs/data-formats.md"
    )


def _reader(name: str):
    if name not in _READERS:
        raise DataError(f"there is no format {name!r}; --format takes one of {', '.join(FORMATS)}")
    return import_module(f".{_READERS[name][0]}", __package__)


def _require_folder(path: Path) -> Path:
    if not path.is_dir():
        what = "is a file, but a recording is a folder" if path.exists() else "does not exist"
        raise DataError(f"the data set {path} {what}; give the folder that holds the images")
    try:
        empty = not any(path.iterdir())
    except OSError as error:
        raise DataError(f"cannot read the data set {path}: {error.strerror}") from error
    if empty:
        raise DataError(f"the data set {path} is an empty folder")
    return path
