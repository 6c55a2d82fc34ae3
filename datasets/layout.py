"""Finding a recording inside the folder that a user names."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..recon.core.errors import DataError
from .names import sorted_names

# Lists of pairs of colour and depth images, in the layout of TUM RGB-D.
ASSOCIATION_FILES = ("associations.txt", "association.txt", "associate.txt", "associated.txt")


def choose_sequence(path: Path, marker: str) -> tuple[Path, tuple[str, ...]]:
    """`path` itself or its first subfolder that holds something like `marker` (a glob), and a note on the choice.

    Raises DataError if there is none.
    """
    if any(path.glob(marker)):
        return path, ()
    found = sorted_names(hit.name for hit in path.iterdir() if hit.is_dir() and any(hit.glob(marker)))
    if not found:
        raise DataError(f"{path} holds no {marker}, and none of its subfolders does")
    if len(found) == 1:
        return path / found[0], ()
    return path / found[0], (f"{path} holds {len(found)} sequences ({', '.join(found)}); {found[0]} was taken",)


def first_file(candidates: Iterable[Path]) -> Path | None:
    """The first of `candidates` that is a file."""
    return next((path for path in candidates if path.is_file()), None)
