"""Every reader of recordings: those of this package, and those that installed packages add (docs/python.md).

Importing this module is cheap: a reader is imported when a folder has to be recognised or read.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, cast

from ..recon.core.errors import DataError
from ..recon.core.events import OnEvent, Warn, ignore
from ..recon.core.plugins import load_plugins

if TYPE_CHECKING:  # loads PyTorch; whoever only wants the names of the formats should not wait for it
    from ..recon.core.frame import Recording

ENTRY_POINTS = "uncle.readers"


class Reader(Protocol):
    """What a reader offers: a module with these two functions, or any object with these methods."""

    def matches(self, path: Path) -> bool:
        """Whether the folder `path` looks like a recording of this format; decided by names alone."""

    def read(self, path: Path) -> Recording:
        """The recording in the folder `path`. Raises DataError."""


@dataclass(frozen=True)
class ReaderSpec:
    """A reader: its name, how its folders are recognised, and where it is.

    name      as in `uncle preprocess --format NAME`
    layout    what a folder of this format contains, for messages
    summary   one line for the help of `uncle preprocess`
    reader    the module of the reader by name, imported when needed; or an object that is one
    """

    name: str
    layout: str
    summary: str
    reader: str | Reader

    def load(self) -> Reader:
        """The reader, imported now."""
        if isinstance(self.reader, str):
            return cast(Reader, import_module(self.reader, __package__))
        return self.reader


# In the order of recognition.
BUILT_IN = (
    ReaderSpec("folder", "camera.json and color/", "own recordings, a plain folder of images", ".folder"),
    ReaderSpec("senfunet", "left_rgb/ or 1/left_rgb/", "rooms of SenFuNet and of `uncle synth`", ".senfunet"),
    ReaderSpec("replica", "results/frame*.jpg", "Replica as rendered for NICE-SLAM", ".replica"),
    ReaderSpec("7scenes", "frame-*.color.png or seq-*/", "7-Scenes", ".seven_scenes"),
    ReaderSpec("tum", "rgb.txt and depth.txt, or associations.txt", "TUM RGB-D", ".tum"),
    ReaderSpec("scannet", "frames/color/ and frames/pose/", "exported scenes of ScanNet", ".scannet"),
)

_READERS: dict[str, ReaderSpec] = {spec.name: spec for spec in BUILT_IN}


def reader_specs() -> dict[str, ReaderSpec]:
    """Every reader by name, in the order of recognition: those of this package come first."""
    plugin_problems()
    return dict(_READERS)


def register_reader(spec: ReaderSpec) -> None:
    """Add a reader for the rest of this process. Raises DataError if its name is taken."""
    if spec.name in _READERS:
        raise DataError(f"there is a reader called {spec.name!r} already; choose another name")
    _READERS[spec.name] = spec


def unregister_reader(name: str) -> None:
    """Remove a reader that `register_reader` added. Raises DataError for any other."""
    if name not in _READERS or name in {spec.name for spec in BUILT_IN}:
        raise DataError(f"{name!r} is not a reader that was added")
    del _READERS[name]


@cache
def plugin_problems() -> tuple[str, ...]:
    """Adds the readers of installed packages, once; one line for each that had to be skipped."""
    return tuple(load_plugins(ENTRY_POINTS, ReaderSpec, register_reader))


def open_dataset(path: Path, format: str | None = None, on_event: OnEvent = ignore) -> Recording:
    """Open the recording in the folder `path`; `format`, the name of a reader, is recognised if not given.

    Raises DataError if the folder is missing, empty, of no known format, or not what its format requires.
    """
    path, specs = Path(path), reader_specs()
    for problem in plugin_problems():
        on_event(Warn(problem))
    name = format or recognise(path, on_event)
    if name not in specs:
        raise DataError(f"there is no format {name!r}; --format takes one of {', '.join(specs)}")
    return specs[name].load().read(_require_folder(path))


def recognise(path: Path, on_event: OnEvent = ignore) -> str:
    """The name of the format of the folder `path`, from what it contains. Raises DataError."""
    path = _require_folder(Path(path))
    specs = reader_specs()
    for spec in specs.values():
        if _matches(spec, path, on_event):
            return spec.name
    layouts = "; ".join(f"{spec.name}: {spec.layout}" for spec in specs.values())
    raise DataError(
        f"cannot tell the format of {path}; looked for {layouts}. Name it with --format, or see docs/data-formats.md"
    )


def _matches(spec: ReaderSpec, path: Path, on_event: OnEvent) -> bool:
    if spec in BUILT_IN:
        return spec.load().matches(path)
    try:
        return spec.load().matches(path)
    except Exception as error:  # a defect of an added reader must not keep the others from working
        on_event(Warn(f"skipped the reader {spec.name!r}: {type(error).__name__}: {error}"))
        return False


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
