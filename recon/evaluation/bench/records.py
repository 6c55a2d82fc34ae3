"""Jobs that are carried out one after the other or side by side, and results that survive an interruption."""

from __future__ import annotations

import json
import os
import platform
import queue
import statistics
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any, Protocol

from ...core.errors import DataError, UncleError
from ...core.events import Note, OnEvent, Warn, ignore
from ...core.files import read_json, write_text
from .process import Record, share_of_cores, stay_on, stop_all

Each = Callable[[dict[str, Record], dict[str, str]], None]


class Job(Protocol):
    """One pass; passes with the same key are the same."""

    @property
    def key(self) -> str:
        """Name of the job in the file of results."""


def load_records(path: Path) -> dict[str, Record]:
    """What earlier calls left in `path`, by key; nothing if there is no such file. Raises DataError if it is broken."""
    try:
        records = read_json(path) if path.exists() else {}
    except ValueError as error:
        raise _no_records(path, str(error)) from error
    except OSError as error:
        raise _no_records(path, error.strerror or str(error)) from error
    if not isinstance(records, dict) or not all(isinstance(record, dict) for record in records.values()):
        raise _no_records(path, "it holds other values")
    return records


def _no_records(path: Path, reason: str) -> DataError:
    return DataError(f"{path} is not a file of results: {reason}; move it away or take another --out")


def carry_out(
    jobs: Sequence[Any], path: Path, execute: Callable[[Any], Record], is_done: Callable[[Any, Record], bool], *,
    parallel: int = 1, session: str | None = None, on_event: OnEvent = ignore, each: Each | None = None,
) -> tuple[dict[str, Record], dict[str, str]]:  # fmt: skip
    """Execute the jobs that `path` does not hold yet, `parallel` at a time, and write it after each.

    `session` names this call (default: the time); `each` is called after every job with what this returns: all records
    of the file and, by key, why a job of this call failed. Failed ones are not written. An interruption ends
    the processes of `run_process` and leaves what is done.
    """
    session = session or time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    records = load_records(path)
    failed: dict[str, str] = {}
    missing = [j for j in jobs if j.key not in records or not is_done(j, records[j.key])]
    mark = {"session": session, "machine": f"{platform.machine()}, {os.cpu_count()} cores"}
    clock = _Clock(len(missing), parallel)

    def tell() -> None:
        if each is not None:
            each(records, failed)

    def take(job: Any, future: Future[tuple[Record, float]]) -> None:
        try:
            record, seconds = future.result()
        except UncleError as error:
            failed[job.key] = str(error)
            clock.count(None)
            on_event(Warn(f"{job.key}: failed, to be tried again by the next call: {error}"))
            tell()
            return
        records[job.key] = record | mark
        write_text(path, json.dumps(records, indent=1) + "\n")
        clock.count(seconds)
        on_event(Note(f"{clock} {job.key}: {seconds:.0f} s"))
        tell()

    _run_all(missing, execute, parallel, take)
    return records, failed


def _run_all(jobs: Sequence[Any], execute: Callable[[Any], Record], parallel: int, take: Callable[..., None]) -> None:
    """Call `take(job, future)` in this thread for each job as it ends, `parallel` of them at work."""
    places: queue.SimpleQueue[list[int]] = queue.SimpleQueue()
    for part in range(parallel):
        places.put(share_of_cores(part, parallel))

    def settle() -> None:
        if parallel > 1:
            stay_on(places.get())

    def once(job: Any) -> tuple[Record, float]:
        began = time.perf_counter()
        return execute(job), time.perf_counter() - began

    waiting = deque(jobs)
    at_work: dict[Future[tuple[Record, float]], Any] = {}
    pool = ThreadPoolExecutor(parallel, initializer=settle)
    stop_all(False)
    try:
        while waiting or at_work:
            while waiting and len(at_work) < parallel:
                job = waiting.popleft()
                at_work[pool.submit(once, job)] = job
            for future in wait(at_work, return_when=FIRST_COMPLETED).done:
                take(at_work.pop(future), future)
    except BaseException:
        stop_all()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


class _Clock:
    """How far a call is, and how long the rest will take if it is like what is done."""

    def __init__(self, total: int, parallel: int) -> None:
        self.total, self.parallel, self.done = total, parallel, 0
        self.seconds: list[float] = []

    def count(self, seconds: float | None) -> None:
        self.done += 1
        self.seconds += [seconds] if seconds is not None else []

    def __str__(self) -> str:
        left = (self.total - self.done) * statistics.fmean(self.seconds or [0.0]) / self.parallel
        return f"[{self.done}/{self.total}, about {duration(left)} left]"


def duration(seconds: float) -> str:
    """A time as a person says it."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
