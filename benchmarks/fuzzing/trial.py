"""One input tried in this process: what became of it."""

from __future__ import annotations

import shutil
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

import click
from uncle.recon.core.errors import UncleError

from .samples import Sample
from .targets import Target, WrongResultError

RIGHT, REFUSED, TRACEBACK, WRONG, MEMORY, HANG, CRASH = (
    "right", "refused", "traceback", "wrong", "memory", "hang", "crash",
)  # fmt: skip
OUTCOMES = (RIGHT, REFUSED, TRACEBACK, WRONG, MEMORY, HANG, CRASH)
_MAX_MESSAGE = 1500  # characters of a line of error
_OUT_OF_MEMORY = ("can't allocate memory", "Insufficient memory", "Unable to allocate", "std::bad_alloc")


@dataclass(frozen=True)
class Outcome:
    """`kind` is one of `OUTCOMES`; `where` tells one defect from another; `text` is the message or the traceback."""

    kind: str
    where: str = ""
    text: str = ""

    @property
    def is_failure(self) -> bool:
        """Whether the program has a defect."""
        return self.kind not in (RIGHT, REFUSED)


def attempt(target: Target, sample: Sample, folder: Path) -> Outcome:
    """Write the sample to `folder`, hand it to the target, and remove the folder."""
    shutil.rmtree(folder, ignore_errors=True)
    try:
        path = sample.write(folder / "input")
    except (OSError, ValueError):  # a mutation made names that no file can have
        return Outcome(RIGHT)
    try:
        return call(target, path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def call(target: Target, path: Path) -> Outcome:
    """What becomes of the input at `path`."""
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        outcome = _call(target, path)
    noise = next((w for w in warned if issubclass(w.category, RuntimeWarning | ResourceWarning | FutureWarning)), None)
    if noise is None or outcome.is_failure:
        return outcome
    where = f"{noise.category.__name__} {Path(noise.filename).name}:{noise.lineno}"
    return Outcome(WRONG, where, f"{noise.filename}:{noise.lineno}: {noise.message}")


def _call(target: Target, path: Path) -> Outcome:
    try:
        target.call(path)
    except WrongResultError as error:
        return Outcome(WRONG, str(error)[:80], traceback.format_exc())
    except (UncleError, click.ClickException) as error:
        if _ran_out_of_memory(error):
            return Outcome(MEMORY, _place(error.__cause__ or error), traceback.format_exc())
        message = str(error)
        if not message or len(message.splitlines()) != 1 or len(message) > _MAX_MESSAGE or not message.isprintable():
            return Outcome(WRONG, f"message {_place(error)}", message)
        return Outcome(REFUSED, text=message)
    except BaseException as error:
        kind = MEMORY if _ran_out_of_memory(error) else TRACEBACK
        return Outcome(kind, _place(error), traceback.format_exc())
    return Outcome(RIGHT)


def _ran_out_of_memory(error: BaseException | None) -> bool:
    while error is not None:
        if isinstance(error, MemoryError) or any(text in str(error) for text in _OUT_OF_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False


def _place(error: BaseException) -> str:
    """The type of an error, and the line of this program that it left last."""
    frames = traceback.extract_tb(error.__traceback__)
    ours = [f for f in frames if "/recon/" in f.filename or "/datasets/" in f.filename or "/cli/" in f.filename]
    last = (ours or frames)[-1] if frames else None
    return type(error).__name__ + (f" {Path(last.filename).name}:{last.lineno}" if last else "")
