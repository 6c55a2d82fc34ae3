"""What the benchmark programs share: processes, fresh run directories, results that survive an interruption, tables."""

from __future__ import annotations

import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

Record = dict[str, Any]
UNCLE = Path(sys.executable).with_name("uncle")


class Job(Protocol):
    """One pass; passes with the same key are the same."""

    @property
    def key(self) -> str: ...


# --- processes and run directories -----------------------------------------------------------------------------------
def process(name: str, command: Sequence[object]) -> tuple[float, str]:
    """Wall seconds of a process and its stdout. Raises RuntimeError with the last line it printed if it failed."""
    began = time.perf_counter()
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
        raise RuntimeError(f"{name}: {last}")
    return round(time.perf_counter() - began, 2), done.stdout


def uncle(*arguments: object) -> float:
    """Run `uncle`; wall seconds of the process. Raises RuntimeError."""
    return process(f"uncle {arguments[0]}", [UNCLE, *arguments])[0]


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
    """What the manifest of `run` says about its map."""
    return json.loads((run / "manifest.json").read_text())["stages"]["map"]["facts"]


# --- results ---------------------------------------------------------------------------------------------------------
def carry_out(
    jobs: Sequence[Job], path: Path, execute: Callable[[Any], Record], is_done: Callable[[Any, Record], bool]
) -> tuple[dict[str, Record], dict[str, str]]:
    """Execute the jobs that `path` does not hold yet, and write it after each.

    Returns all records of the file and, by key, why a job of this call failed; failed ones are not written.
    """
    session = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    records: dict[str, Record] = json.loads(path.read_text()) if path.exists() else {}
    missing, failed = [j for j in jobs if j.key not in records or not is_done(j, records[j.key])], {}
    for number, job in enumerate(missing, start=1):
        print(f"[{number}/{len(missing)}] {job.key}", file=sys.stderr, flush=True)
        try:
            record = execute(job)
        except RuntimeError as error:
            failed[job.key] = str(error)
            print(f"failed, to be tried again by the next call: {error}", file=sys.stderr)
            continue
        records[job.key] = record | {"session": session, "machine": f"{platform.machine()}, {os.cpu_count()} cores"}
        part = path.with_suffix(".part")
        part.write_text(json.dumps(records, indent=1) + "\n")
        part.replace(path)  # never half a file
    return records, failed


def surface_scores(surface: Record) -> Record:
    """F, precision and recall by threshold and the accuracy, of a scored mesh; SI units, ratios 0..1."""
    found: Record = {}
    for score in surface["mesh"]["scores"]:
        at = f"{round(score['threshold_m'] * 100)}cm"
        found |= {f"{name}_{at}": score[name] for name in ("f_score", "precision", "recall")}
    return found | {"accuracy_mean_m": surface["mesh"]["accuracy_mean_m"]}


# --- tables ----------------------------------------------------------------------------------------------------------
def cell(records: Iterable[Record], key: str, factor: float, digits: int, with_range: bool) -> str:
    """Median over the records that have `key`, with [minimum, maximum] if asked; "-" if none has."""
    values = [record[key] * factor for record in records if record.get(key) is not None]
    if not values:
        return "-"
    middle = f"{statistics.median(values):.{digits}f}"
    return (
        f"{middle} [{min(values):.{digits}f}, {max(values):.{digits}f}]" if with_range and len(values) > 1 else middle
    )


def ratio(records: list[Record], baseline: list[Record], key: str) -> str:
    """Median of `key` over that of the baseline, from calls of the program that measured both; else "-"."""
    shared = {record["session"] for record in records} & {record["session"] for record in baseline}
    over, under = ([r[key] for r in part if r["session"] in shared] for part in (records, baseline))
    return f"{statistics.median(over) / statistics.median(under):.2f}" if shared else "-"


def table(header: list[str], rows: list[list[str]]) -> list[str]:
    """Lines of a Markdown table without the columns that are "-" in every row; none if there are no rows."""
    kept = [column for column in range(len(header)) if any(row[column] != "-" for row in rows)]
    lines = [[header[column] for column in kept], ["---"] * len(kept), *([row[c] for c in kept] for row in rows)]
    return ["| " + " | ".join(line) + " |" for line in lines] if rows else []
