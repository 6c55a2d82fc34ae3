"""What the process needs before a command runs: three open streams, and a place for the settings of matplotlib."""

from __future__ import annotations

import atexit
import os
import shutil
import sys
import tempfile
from pathlib import Path


def open_missing_streams() -> None:
    """Connect closed streams (`uncle ... >&-`) to nothing.

    Otherwise the next file that is opened takes the number of the stream, and what is printed would be written into it.
    """
    for number, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(number)
        except OSError:
            null = os.open(os.devnull, os.O_RDWR)
            if null != number:
                os.dup2(null, number)
                os.close(null)
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, mode, closefd=False))  # noqa: SIM115 - for the whole process


def provide_matplotlib_folder() -> None:
    """Give matplotlib a folder of this process where the home directory cannot be written; it would warn otherwise."""
    if "MPLCONFIGDIR" in os.environ:
        return
    config = os.environ.get("XDG_CONFIG_HOME")
    try:
        home = Path(config) if config else Path.home() / ".config"
    except RuntimeError:  # a user without a home
        home = Path("/nonexistent")
    place = home / "matplotlib"
    while not place.exists() and place != place.parent:
        place = place.parent
    if place.is_dir() and os.access(place, os.W_OK):
        return
    try:
        folder = tempfile.mkdtemp(prefix="uncle-matplotlib-")
    except OSError:
        return  # matplotlib says what it needs if a chart is drawn
    os.environ["MPLCONFIGDIR"] = folder
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
