"""One owner per run directory: who writes into it, and what others are told meanwhile.

The lock is one of the operating system (`flock`) on a file in the run. It ends with the process that holds it, however
that ends, so a lock that is left behind by a dead process is free.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

from ..core.errors import RunError
from ..core.events import Note, OnEvent, Warn, ignore
from ..core.files import explain_write_errors
from .directory import RunDirectory

_POLL_S = 0.2
_READ_ONLY = (errno.EROFS, errno.EACCES, errno.EPERM)
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)


@dataclass(frozen=True)
class Owner:
    """The process that writes into a run; `started` is local time."""

    pid: int
    host: str
    command: str
    started: str

    @staticmethod
    def here(command: str) -> Owner:
        """This process."""
        return Owner(os.getpid(), socket.gethostname(), command, time.strftime("%Y-%m-%d %H:%M:%S"))

    @staticmethod
    def read(file: int) -> Owner | None:
        """The owner that an open lock file names; None if it names none."""
        try:
            return Owner(**json.loads(os.pread(file, 4096, 0)))
        except (OSError, ValueError, TypeError):
            return None

    def write(self, file: int) -> None:
        """Name this owner in an open lock file."""
        os.ftruncate(file, 0)
        os.pwrite(file, json.dumps(asdict(self)).encode(), 0)

    def __str__(self) -> str:
        host = "" if self.host == socket.gethostname() else f" on {self.host}"
        return f"`{self.command}` (process {self.pid}{host}, since {self.started})"


@contextmanager
def writing(
    run: RunDirectory, stage: str, on_event: OnEvent = ignore, *, is_new: bool = False, may_be_read_only: bool = False
) -> Iterator[bool]:
    """Own the run while a stage writes into it; yields True, or False for a run that cannot be written.

    is_new             the run may not exist yet: its folder is made, and removed again if it stays empty
    may_be_read_only   yield False, instead of raising, where the folder is read-only

    Raises RunError that names the owner if another process writes into the run, unless `run.waits`; RunError if there
    is no run, or it cannot be written.
    """
    made = is_new and not run.root.exists()
    if is_new:
        with explain_write_errors(run.root):
            run.root.mkdir(parents=True, exist_ok=True)
    else:
        run.require()
    try:
        file = _acquire(run, f"uncle {stage}", on_event)
    except OSError as error:
        if may_be_read_only and error.errno in _READ_ONLY:
            yield False
            return
        with explain_write_errors(run.lock_path):
            raise
    try:
        yield True
    finally:
        run.lock_path.unlink(missing_ok=True)
        os.close(file)
        if made and run.root.exists() and not any(run.root.iterdir()):
            run.root.rmdir()


@contextmanager
def reading(run: RunDirectory) -> Iterator[None]:
    """Read a run without owning it. Raises RunError if another process changed its results meanwhile."""
    before = run.load_manifest()
    yield
    after = run.load_manifest()
    if (before.stages, before.outdated) != (after.stages, after.outdated):
        raise RunError(f"{run.root} was changed by another command while it was read; run this command again")


@contextmanager
def writing_to(run: RunDirectory, out: Path, stage: str, on_event: OnEvent = ignore) -> Iterator[None]:
    """`writing` if the path `out` lies in the run, else `reading`."""
    if out.resolve().is_relative_to(run.root.resolve()):
        with writing(run, stage, on_event):
            yield
    else:
        with reading(run):
            yield


def _acquire(run: RunDirectory, command: str, on_event: OnEvent) -> int:
    """The open and locked lock file. Raises RunError if another process has it, OSError if it cannot be made."""
    told = False
    while True:
        file = os.open(run.lock_path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        try:
            if _lock(file, run, on_event):
                if _is_in_place(file, run.lock_path):
                    if (dead := Owner.read(file)) is not None:
                        on_event(Note(f"{dead} did not end regularly; its lock of {run.root} is taken over"))
                    Owner.here(command).write(file)
                    return file
            else:
                owner = Owner.read(file) or "another command"
                if not run.waits:
                    raise RunError(f"{run.root} is in use by {owner}; run this again when it has ended, or add --wait")
                if not told:
                    on_event(Note(f"waiting for {owner} to end"))
                told = True
                time.sleep(_POLL_S)
        except BaseException:
            os.close(file)
            raise
        os.close(file)


def _lock(file: int, run: RunDirectory, on_event: OnEvent) -> bool:
    """Whether this process has the lock now."""
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise
        on_event(Warn(f"the file system of {run.root} has no locks; do not run two commands on it at the same time"))
    return True


def _is_in_place(file: int, path: Path) -> bool:
    """Whether the open file is still the one at `path`: its last owner removes it."""
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False
