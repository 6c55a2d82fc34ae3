"""An input of the program as a value: the files of a folder."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

FOLDER, LOOP, PIPE, ENDLESS = "folder", "loop", "pipe", "endless"  # what can stand in the place of a file


@dataclass(frozen=True)
class Special:
    """Something else than a file at the place of one: an empty folder, a link to itself, a pipe, an endless file."""

    kind: str


@dataclass(frozen=True)
class Sample:
    """A valid input.

    name    of the sample, for reports
    files   path in the folder -> content
    main    path in the folder that is given to the program; "" for the folder itself
    """

    name: str
    files: dict[str, bytes | Special]
    main: str = ""

    def write(self, root: Path) -> Path:
        """Write the files below `root` and return what the program is given."""
        root.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            path = root / name
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Special):
                _make_special(path, content.kind)
            else:
                path.write_bytes(content)
        return root / self.main

    @staticmethod
    def read(name: str, root: Path, main: str = "") -> Sample:
        """The sample that `write` wrote to `root`, without what is no file."""
        paths = sorted(path for path in root.rglob("*") if path.is_file() and not path.is_symlink())
        return Sample(name, {str(path.relative_to(root)): path.read_bytes() for path in paths}, main)


def _make_special(path: Path, kind: str) -> None:
    if kind == FOLDER:
        path.mkdir()
    elif kind == LOOP:
        path.symlink_to(path.name)
    elif kind == PIPE:
        os.mkfifo(path)
    else:
        path.symlink_to("/dev/zero")
