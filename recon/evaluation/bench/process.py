"""The program as processes of its own: how it is started, on which cores, and the run directories it works in."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ...core.errors import RunError

Record = dict[str, Any]
LAUNCHER = (sys.executable, "-m", "uncle.cli.main")
_THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "TBB_NUM_THREADS")
_running: set[subprocess.Popen[str]] = set()
_lock, _stopping = threading.Lock(), threading.Event()


def run_process(
    name: str, command: Sequence[object], threads: int | None = None, log: Path | None = None
) -> tuple[float, str]:
    """Wall seconds of a process and its stdout; `threads` limits its threads, and its stderr is appended to `log`.

    Raises RunError with the last line it printed if it failed.
    """
    if _stopping.is_set():
        raise RunError(f"{name}: stopped")
    began = time.perf_counter()
    environment = {**os.environ, **dict.fromkeys(_THREADS, str(threads))} if threads else None
    child = subprocess.Popen(
        [*map(str, command)], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env=environment, errors="replace",
    )  # fmt: skip
    with _lock:
        _running.add(child)
    try:
        out, messages = child.communicate()
    finally:
        with _lock:
            _running.discard(child)
        if child.poll() is None:
            child.terminate()
    if log is not None:
        with log.open("a") as file:
            file.write(f"--- {name}\n{messages}")
    if child.returncode:
        raise RunError(f"{name}: {_last_line(child.returncode, messages, out)}")
    return round(time.perf_counter() - began, 2), out


def stop_all(stop: bool = True) -> None:
    """End the processes that `run_process` waits for in other threads, and start no more until `stop_all(False)`."""
    (_stopping.set if stop else _stopping.clear)()
    with _lock:
        for child in _running if stop else ():
            child.terminate()


def uncle(*arguments: object, threads: int | None = None, log: Path | None = None) -> float:
    """Run the program; wall seconds of the process. Raises RunError."""
    return run_process(f"uncle {arguments[0]}", [*LAUNCHER, *arguments], threads, log)[0]


def share_of_cores(part: int, parts: int) -> list[int]:
    """The cores of this process that the `part`-th of `parts` neighbours gets, at least one, whichever thread asks."""
    cores = (
        sorted(os.sched_getaffinity(os.getpid())) if hasattr(os, "sched_getaffinity") else [*range(os.cpu_count() or 1)]
    )
    each = max(1, len(cores) // parts)
    start = part * each % len(cores)
    return cores[start : start + each]


def stay_on(cores: Sequence[int]) -> None:
    """Keep the calling thread, and the processes that it starts, on `cores`; nothing where the system cannot."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)


# --- run directories -------------------------------------------------------------------------------------------------
def new_run(base: Path, run: Path) -> None:
    """Make `run` a fresh copy of the preprocessed run `base` that borrows its frames."""
    shutil.rmtree(run, ignore_errors=True)  # beta maps of an earlier job must not be scored again
    run.mkdir(parents=True)
    (run / "frames").symlink_to((base / "frames").resolve(), target_is_directory=True)
    for file in base.glob("*.*"):
        shutil.copy(file, run)  # manifest and reference trajectory


def sensor_options(sensors: str) -> list[str]:
    """Names joined by + as options of a command; none for "", which leaves the choice to the command."""
    return ["--sensors", *sensors.split("+")] if sensors else []


def map_facts(run: Path) -> Record:
    """Facts of the `map` stage in the manifest of `run`."""
    return json.loads((run / "manifest.json").read_text())["stages"]["map"]["facts"]


def map_costs(run: Path, wall_s: float) -> Record:
    """Time and memory of the map of `run`, which took `wall_s` as a process."""
    facts = map_facts(run)
    gpu = {"gpu_memory_mb": facts["gpu_memory_mb"]} if "gpu_memory_mb" in facts else {}
    return {"wall_s": wall_s, "stage_seconds": facts["seconds"], "peak_memory_mb": facts["peak_memory_mb"]} | gpu


def evaluate(run: Path, *options: object, threads: int | None = None, log: Path | None = None) -> Record:
    """Mesh and score a finished map; returns the content of `RUN/metrics.json`. Raises RunError."""
    uncle("mesh", "--run", run, "--overwrite", threads=threads, log=log)
    uncle("eval", "--run", run, "--json", *options, threads=threads, log=log)
    return json.loads((run / "metrics.json").read_text())


def _last_line(code: int, *texts: str) -> str:
    """The last line of the first text that is not blank, without the program's own "Error: "."""
    lines = next((text.strip().splitlines() for text in texts if text.strip()), [])
    return lines[-1].removeprefix("Error: ") if lines else f"ended with code {code} and no message"
