"""Batches of inputs over all targets until the time is up; survives whatever becomes of the process that tries them."""

from __future__ import annotations

import json
import os
import select
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .trial import CRASH, HANG, OUTCOMES, REFUSED, RIGHT

HANG_S = 60.0
BATCH_S = 4.0  # about as long as one target keeps its turn
FIRST_COUNT, MAX_COUNT = 5, 400
START_S = 300.0  # for a worker to import everything, on a busy machine


@dataclass
class Tally:
    """What became of the inputs of one target."""

    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(OUTCOMES, 0))
    seconds: float = 0.0
    slowest_s: float = 0.0
    defects: dict[str, int] = field(default_factory=dict)  # where -> number of inputs that show it

    @property
    def inputs(self) -> int:
        """All that were tried."""
        return sum(self.counts.values())

    def next_count(self) -> int:
        """Inputs that fit into a turn."""
        if not self.inputs:
            return FIRST_COUNT
        return int(min(max(BATCH_S * self.inputs / max(self.seconds, 1e-3), FIRST_COUNT), MAX_COUNT))


class Died(Exception):
    """The worker ended, or had to be ended; `kind` says how."""

    def __init__(self, kind: str) -> None:
        super().__init__(kind)
        self.kind = kind


class Worker:
    """A process of `worker.py`."""

    def __init__(self, command: Sequence[str]) -> None:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "MPLBACKEND": "agg"}
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True
        )
        self._rest = b""
        self._next(START_S)

    def batch(self, order: dict[str, Any]) -> Iterator[dict[str, Any]]:
        """What the worker tells about a batch. Raises Died."""
        assert self.process.stdin is not None
        try:
            self.process.stdin.write(json.dumps(order).encode() + b"\n")
            self.process.stdin.flush()
        except OSError as error:
            raise Died(CRASH) from error
        while True:
            message = self._next(HANG_S)
            yield message
            if "done" in message:
                return

    def _next(self, seconds: float) -> dict[str, Any]:
        assert self.process.stdout is not None
        end = time.monotonic() + seconds
        while b"\n" not in self._rest:
            left = end - time.monotonic()
            if left <= 0 or not select.select([self.process.stdout], [], [], left)[0]:
                self.stop()
                raise Died(HANG)
            data = os.read(self.process.stdout.fileno(), 1 << 16)
            if not data:
                self.stop()
                raise Died(CRASH)
            self._rest += data
        line, _, self._rest = self._rest.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        return message

    def stop(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()


class Fuzzer:
    """Gives each target its turns, counts, and keeps the input of every defect under `out`/defects."""

    def __init__(self, targets: Sequence[str], out: Path, first_seed: int, say: Callable[[str], None]) -> None:
        self.out, self.say, self.seed = out, say, first_seed
        self.tallies = {name: Tally() for name in targets}
        self._worker: Worker | None = None

    def run(self, seconds: float) -> None:
        """Try inputs for that long."""
        began = told = time.monotonic()
        while True:
            for name, tally in self.tallies.items():
                now = time.monotonic()
                if now - began >= seconds:
                    self._stop()
                    return
                if now - told >= 15:
                    told = now
                    self.say(self._progress(now - began, seconds))
                self.turn(name, tally)
            (self.out / "table.md").write_text(self.table(time.monotonic() - began))

    def command(self) -> list[str]:
        """What starts a worker."""
        folder = self.out / "worker"
        folder.mkdir(parents=True, exist_ok=True)
        program = Path(__file__).parents[1] / "fuzz.py"
        return [sys.executable, str(program), "--worker", str(self.out / "corpus"), str(folder)]

    def turn(self, name: str, tally: Tally) -> None:
        """One batch of inputs for the target `name`."""
        worker = self._worker or Worker(self.command())
        self._worker = worker
        self.seed += 1
        order = {"target": name, "seed": self.seed, "count": tally.next_count(), "known": list(tally.defects)}
        began, current = time.monotonic(), {}
        try:
            for message in worker.batch(order):
                if "begin" in message:
                    current, began_input = message, time.monotonic()
                elif "end" in message and current["counts"]:
                    tally.slowest_s = max(tally.slowest_s, time.monotonic() - began_input)
                    self._count(name, tally, message["end"])
                elif "defect" in message:
                    self._keep(name, message["defect"], Path(message["sample"]["folder"]), message["sample"]["main"])
        except Died as died:
            self._worker = None
            if current:
                self._died(name, tally, current, died.kind)
        tally.seconds += time.monotonic() - began

    def _count(self, name: str, tally: Tally, outcome: dict[str, str]) -> None:
        tally.counts[outcome["kind"]] += 1
        if outcome["kind"] not in (RIGHT, REFUSED):
            tally.defects[outcome["where"]] = tally.defects.get(outcome["where"], 0) + 1

    def _died(self, name: str, tally: Tally, current: dict[str, Any], kind: str) -> None:
        """Counts and keeps the input that the worker had at hand, which it wrote below its folder."""
        where = f"{kind} of {current['begin']}: {current['mutations']}"
        self._count(name, tally, {"kind": kind, "where": where})
        errors = (self.out / "worker" / "stderr.txt").read_text(errors="replace")[-3000:]
        main = current.get("main", "")
        self._keep(name, {"kind": kind, "where": where, "text": errors}, self.out / "worker" / "work", main)

    def _keep(self, name: str, defect: dict[str, str], folder: Path, main: str) -> None:
        defects = self.out / "defects"
        place = defects / f"{len(list(defects.glob('*'))) + 1:03d}-{name.replace(' ', '-').replace('/', '')}"
        if (folder / "input").exists():
            shutil.copytree(folder / "input", place / "input", symlinks=True, copy_function=_copy)
        place.mkdir(parents=True, exist_ok=True)
        (place / "defect.json").write_text(json.dumps({"target": name, "main": main, **defect}, indent=1))
        first = defect["text"].strip().splitlines()[-1:] or [""]
        self.say(f"{name}: {defect['kind']} ({defect['where'][:120]}): {first[0][:200]}")
        self.say(f"  again: python benchmarks/fuzz.py --repeat {place}")

    def _stop(self) -> None:
        if self._worker is not None:
            self._worker.stop()
            self._worker = None

    def _progress(self, passed: float, total: float) -> str:
        count = sum(tally.inputs for tally in self.tallies.values())
        failures = sum(sum(tally.defects.values()) for tally in self.tallies.values())
        left = max(total - passed, 0)
        return f"{count} inputs, {count / passed:.1f}/s, {failures} with a defect, {left / 60:.0f} min left"

    def table(self, seconds: float) -> str:
        """Markdown: a line for each target, and their sum."""
        head = [
            "target",
            "inputs",
            "right",
            "refused in one line",
            "traceback",
            "wrong",
            "memory",
            "hang",
            "crash",
            "slowest",
        ]
        lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
        total = Tally()
        for name, tally in self.tallies.items():
            lines.append(_row(name, tally))
            for kind in OUTCOMES:
                total.counts[kind] += tally.counts[kind]
            total.slowest_s = max(total.slowest_s, tally.slowest_s)
        return "\n".join([*lines, _row("all", total), "", f"{seconds / 60:.0f} minutes, seeds to {self.seed}", ""])


def _row(name: str, tally: Tally) -> str:
    counts = " | ".join(str(tally.counts[kind]) for kind in OUTCOMES)
    return f"| {name} | {tally.inputs} | {counts} | {tally.slowest_s:.1f} s |"


def _copy(source: str, target: str) -> None:
    """Pipes are made anew: reading one would wait."""
    if Path(source).is_fifo():
        os.mkfifo(target)
    else:
        shutil.copy(source, target, follow_symlinks=False)
