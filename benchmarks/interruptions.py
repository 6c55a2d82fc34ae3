"""Two commands on one run at random moments, one of them killed in some of the cases; see README.md.

The run begins with frames, map and mesh of variant 0. The first command makes variant 1, the second one variant 2:
other frames of the data set (preprocess) or another seed (map). So every file shows which command wrote it.
"""

from __future__ import annotations

import argparse
import hashlib
import itertools
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import carry_out
from uncle.recon.core.errors import RunError, UncleError
from uncle.recon.evaluation.bench.process import LAUNCHER, Record, uncle
from uncle.recon.evaluation.bench.tables import markdown_table
from uncle.recon.run.directory import RunDirectory

STAGES = ("preprocess", "map", "mesh")
PAIRS = tuple(itertools.product(STAGES, STAGES))
VARIANTS = 3
REFUSED = (
    "is in use by",
    "cannot be used",
    "has no finished",
    "changed by another command",
)  # of a line of the program
NO_RESULTS = ("manifest.json", "done", "frames.part")  # times; this program's mark; an interrupted preprocess
WAIT_S = 600


class Job(NamedTuple):
    """Two commands. Times are shares of the usual time of a command: the second one starts `second_after` of that of
    the first, and `killed` ("first", "second" or "") is killed `kill_after` its own start."""

    number: int
    first: str
    second: str
    waits: bool  # the second has --wait
    second_after: float
    killed: str
    kill_after: float
    resumes: bool  # the map is then made again with --resume

    @property
    def key(self) -> str:
        return "|".join(map(str, self))


def plan(moments: int, seed: int) -> list[Job]:
    """Every pair of commands as often as every other; the first of more moments are those of fewer."""
    order = np.random.default_rng(seed).permutation(len(PAIRS))
    jobs = []
    for number in range(moments):
        rng = np.random.default_rng([seed, number])
        first, second = PAIRS[order[number % len(PAIRS)]]
        killed = ("", "first", "second")[rng.integers(3)]
        shares = np.round(rng.uniform(0, 1, 2), 3).tolist()
        jobs.append(Job(number, first, second, bool(rng.integers(2)), shares[0], killed, shares[1],
                        bool(rng.integers(2))))  # fmt: skip
    return jobs


@dataclass(frozen=True)
class Undisturbed:
    """Runs that one command after the other made, by variant of the frames and of the map; made when asked for."""

    dataset: Path
    folder: Path
    map_options: tuple[str, ...]

    def command(self, stage: str, run: Path, variant: int) -> list[object]:
        """The arguments that make a variant."""
        if stage == "preprocess":
            frames = f"{variant}::{VARIANTS}"
            return [stage, self.dataset, "--run", run, "--frames", frames, "--force"]  # few frames may be in doubt
        return [stage, "--run", run, *(["--seed", variant, *self.map_options] if stage == "map" else [])]

    def run(self, frames: int, seed: int) -> Path:
        """The finished run. Raises RunError."""
        run = self.folder / f"frames-{frames}-seed-{seed}"
        if not (run / "done").exists():
            shutil.rmtree(run, ignore_errors=True)
            for stage in STAGES:
                uncle(*self.command(stage, run, frames if stage == "preprocess" else seed))
            (run / "done").touch()
        return run

    def seconds(self, run: Path) -> dict[str, float]:
        """What each command takes at present, in a new run: an earlier measurement would be of another load."""
        shutil.rmtree(run, ignore_errors=True)
        return {stage: uncle(*self.command(stage, run, 0)) for stage in STAGES}

    def digests(self, frames: int, seed: int) -> dict[str, str]:
        """`digests` of the run."""
        return digests(self.run(frames, seed))


def digests(run: Path) -> dict[str, str]:
    """SHA-256 of every file that a command made, by name; the manifest has times and is left out, like hidden files."""
    names = (path.relative_to(run) for path in sorted(run.rglob("*")) if path.is_file())
    kept = (name for name in names if name.parts[0] not in NO_RESULTS and name.name[0] != ".")
    return {str(name): digest_of((run / name).read_bytes()) for name in kept}


def digest_of(content: bytes) -> str:
    """SHA-256 as text."""
    return hashlib.sha256(content).hexdigest()


def stage_of(name: str) -> str:
    """The command that makes a file of a run."""
    if name.startswith("frames/") or name == "trajectory_gt.txt":
        return "preprocess"
    return "mesh" if name == "mesh.ply" else "map"


def different(run: Path, expected: dict[str, str], stages: Sequence[str]) -> list[str]:
    """Names of the files of `stages` that are not those expected, or are missing, or are too many."""
    found = digests(run)
    return [
        name
        for name in sorted({*found, *expected})
        if stage_of(name) in stages and found.get(name) != expected.get(name)
    ]


@dataclass(frozen=True)
class State:
    """What a run says of itself: the variants of its frames and its map, None where it says that they are of no use;
    whether its mesh is good; and the names of the files that contradict."""

    frames: int | None
    seed: int | None
    has_mesh: bool
    wrong: tuple[str, ...]

    def __str__(self) -> str:
        parts = [f"frames {self.frames}" if self.frames is not None else "no frames"]
        parts += [f"map {self.seed}"] if self.seed is not None else []
        return ", ".join(parts + ["mesh"] * self.has_mesh)


def state(run: Path, undisturbed: Undisturbed) -> State:
    """Read what the manifest claims and compare it with the files."""
    directory = RunDirectory(run)
    good: dict[str, dict[str, Any]] = {}
    for stage in STAGES:
        try:
            good[stage] = directory.require_stage(stage).facts
        except RunError:
            continue
    if "preprocess" not in good:
        return State(None, None, False, ())
    frames, seed = int(good["preprocess"]["frame_range"][0]), good.get("map", {}).get("seed")
    expected = undisturbed.digests(frames, seed or 0)
    return State(frames, seed, "mesh" in good, tuple(different(run, expected, [*good])))


class Ended(NamedTuple):
    """How a command ended: its exit code, when, and the last line that it wrote."""

    code: int
    at_s: float
    line: str

    def __str__(self) -> str:
        if self.code == 0:
            return "done"
        return "killed" if self.code < 0 else next((text for text in REFUSED if text in self.line), self.line)

    @property
    def is_right(self) -> bool:
        """Whether it did its work, was killed, or ended with a line that says why it does not."""
        return self.code <= 0 or (self.line.startswith("Error: ") and any(text in self.line for text in REFUSED))


def disturb(job: Job, run: Path, undisturbed: Undisturbed, usual_s: dict[str, float]) -> tuple[Ended, Ended, bool]:
    """Run both commands and kill one; how they ended, and whether both ran at one time."""
    began, children, logs = time.monotonic(), [], []
    kill_at = None

    def start(stage: str, variant: int, *more: str) -> None:
        log = run.parent / f"{len(children)}.log"
        command = [*LAUNCHER, *undisturbed.command(stage, run, variant), *more]
        with log.open("wb") as file:
            children.append(subprocess.Popen([*map(str, command)], stdin=subprocess.DEVNULL,
                                             stdout=subprocess.DEVNULL, stderr=file))  # fmt: skip
        logs.append(log)

    starts_at = job.second_after * usual_s[job.first]
    if job.killed:
        own = job.first if job.killed == "first" else job.second
        kill_at = (starts_at if job.killed == "second" else 0.0) + job.kill_after * usual_s[own]
    ended: dict[int, float] = {}
    overlapped = False
    start(job.first, 1)
    while len(children) < 2 or len(ended) < 2 or kill_at is not None:
        passed = time.monotonic() - began
        if len(children) < 2 and passed >= starts_at:
            overlapped = 0 not in ended
            start(job.second, 2, *(["--wait"] if job.waits else []))
        victim = ("first", "second").index(job.killed) if job.killed else 0
        if kill_at is not None and passed >= kill_at and victim < len(children):
            children[victim].kill()
            kill_at = None
        for place, child in enumerate(children):
            if place not in ended and child.poll() is not None:
                ended[place] = passed
        if passed > WAIT_S:
            for child in children:
                child.kill()
        time.sleep(0.005)
    lines = [(log.read_text(errors="replace").strip().splitlines() or [""])[-1] for log in logs]
    first, second = (Ended(child.returncode, ended[k], lines[k]) for k, child in enumerate(children))
    return first, second, overlapped


def made_by(stage: str, commands: Sequence[tuple[str, int, Ended]], before: int) -> set[int]:
    """Variants that the result of a stage can have: that of the last command that ended well, or of the killed one."""
    well = sorted((ended.at_s, variant) for name, variant, ended in commands if name == stage and ended.code == 0)
    killed = {variant for name, variant, ended in commands if name == stage and ended.code < 0}
    return killed | {well[-1][1] if well else before}


def execute(job: Job, undisturbed: Undisturbed, usual_s: dict[str, float], work: Path) -> Record:
    """Disturb a run and finish it. Raises RunError."""
    run = work / "run"
    shutil.rmtree(work, ignore_errors=True)
    shutil.copytree(undisturbed.run(0, 0), run)
    first, second, overlapped = disturb(job, run, undisturbed, usual_s)
    commands = [(job.first, 1, first), (job.second, 2, second)]
    found = state(run, undisturbed)
    faults = [f"{stage}: {ended.line}" for stage, _, ended in commands if not ended.is_right]
    faults += [f"{name} is of something else" for name in found.wrong]
    if found.frames not in {None, *made_by("preprocess", commands, 0)}:
        faults.append(f"frames of variant {found.frames}")
    if found.seed not in {None, *made_by("map", commands, 0)}:
        faults.append(f"map of variant {found.seed}")
    again = [(stage, variant) for stage, variant, ended in commands if ended.code != 0 and stage != "mesh"]
    wanted = finish(run, undisturbed, found, again, job)
    faults += [f"{name} differs in the end" for name in different(run, undisturbed.digests(*wanted), STAGES)]
    return job._asdict() | {
        "first_ended": str(first), "second_ended": str(second), "found": str(found), "faults": faults,
        "overlapped": overlapped, "finished": f"frames {wanted[0]}, map {wanted[1]}, mesh",
    }  # fmt: skip


def finish(
    run: Path, undisturbed: Undisturbed, found: State, again: Sequence[tuple[str, int]], job: Job
) -> tuple[int, int]:
    """Give the commands `again` that did not end well once more, then those that make the rest; the variants made."""
    wanted = {"preprocess": found.frames or 0, "map": found.seed or 0} | dict(again)
    resume = ["--resume"] if job.resumes else []
    uncle(*undisturbed.command("preprocess", run, wanted["preprocess"]))
    uncle(*undisturbed.command("map", run, wanted["map"]), *resume)
    uncle(*undisturbed.command("mesh", run, 0))
    return wanted["preprocess"], wanted["map"]


def markdown(records: Sequence[Record]) -> str:
    """One row for each pair of commands."""
    header = ["", "first", "second", "starts at %", "both ran", "to kill", "at %", "first ended", "second ended"]
    header += ["the run then has", "in the end", "faults"]
    rows = []
    for record in records:
        begin = [str(record["number"]), record["first"], record["second"] + " --wait" * record["waits"]]
        kill = [record["killed"], f"{100 * record['kill_after']:.0f}" if record["killed"] else ""]
        end = [record[name] for name in ("first_ended", "second_ended", "found", "finished")]
        faults = "; ".join(record["faults"]) or "none"
        rows.append(
            [
                *begin,
                f"{100 * record['second_after']:.0f}",
                "yes" if record["overlapped"] else "no",
                *kill,
                *end,
                faults,
            ]
        )
    return "\n".join(markdown_table(header, rows))


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--moments", type=int, default=20, help="how many pairs of commands [20]")
    parser.add_argument("--seed", type=int, default=0, help="of pairs and moments [0]")
    parser.add_argument("--map-options", type=shlex.split, default=(), help="of `uncle map`, in one string")
    parser.add_argument("--out", type=Path, default=Path("bench-out"), help="results and run directories [bench-out]")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing and print the table; 1 if anything is a mixture, differs or failed."""
    options = parse(arguments)
    folder = options.out / options.dataset.resolve().name
    undisturbed = Undisturbed(options.dataset.resolve(), folder / "undisturbed", tuple(options.map_options))
    jobs = plan(options.moments, options.seed)
    options.out.mkdir(parents=True, exist_ok=True)
    usual_s = undisturbed.seconds(folder / "timing")
    once = partial(execute, undisturbed=undisturbed, usual_s=usual_s, work=folder / "work")
    records, failed = carry_out(
        jobs, options.out / "interruptions.json", once, lambda job, record: "overlapped" in record
    )
    done = [records[job.key] for job in jobs if job.key in records]
    print(markdown(done))
    faulty = [record for record in done if record["faults"]]
    both, killed = (
        sum(r["overlapped"] for r in done),
        sum("killed" in (r["first_ended"], r["second_ended"]) for r in done),
    )
    print(
        f"\n{len(done) - len(faulty)} of {len(jobs)} without fault; "
        f"in {both} both ran at one time, in {killed} one was killed"
    )
    return 1 if failed or faulty else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
