"""What the `uncle pretrain` commands have in common: recordings to learn from."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..recon.core.frame import Recording
    from ..recon.run.frames import RunFrames


def open_sources(paths: Sequence[Path]) -> Iterator[tuple[str, Recording | RunFrames]]:
    """Name and frames of each data set or run directory. Raises DataError, RunError."""
    from ..datasets import open_dataset
    from ..recon.run.directory import RunDirectory
    from ..recon.run.frames import RunFrames

    for path in paths:
        is_run = (path / "manifest.json").is_file()
        yield str(path), RunFrames(RunDirectory(path)) if is_run else open_dataset(path)
