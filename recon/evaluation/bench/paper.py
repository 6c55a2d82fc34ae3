"""`uncle bench paper`: prepare the data sets, carry out the jobs, and keep the tables up to date."""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ...core.errors import ConfigError, UncleError
from ...core.events import Note, OnEvent, Warn, ignore
from ...core.files import write_text
from . import process, scores
from .paper_tables import Failures, paper_tables, statistics_json
from .plan import SETTINGS, Choice, Job, Scene, is_done, plan, scene_name, synth_arguments, with_timing
from .process import Record
from .records import carry_out, load_records
from .tables import Table, page

KEPT = ("metrics.json", "config.toml", "manifest.json", "trajectory.txt", "tracking.json", "log.txt")


@dataclass(frozen=True)
class Bench:
    """Where and how: the folder of the results, processes beside each other, whether run directories are kept."""

    out: Path
    parallel: int = 1
    keep_runs: bool = False
    frames: str = ""  # START:STOP:STEP of every data set; "" are all

    @property
    def records_path(self) -> Path:
        """File of all results, by key of their job."""
        return self.out / "runs.json"

    @property
    def threads(self) -> int | None:
        """Of each process; None leaves it to the process, which then has the machine to itself."""
        return len(process.share_of_cores(0, self.parallel)) if self.parallel > 1 else None


def run_paper(
    bench: Bench, datasets: Sequence[str], choice: Choice, on_event: OnEvent = ignore
) -> tuple[list[Table], dict[str, str]]:
    """Run what is missing and write `runs.json`, `paper.json`, `paper.md` and `paper.html`, after every run.

    Returns the tables and, by key, why a job failed. Raises ConfigError if there is nothing to do, RunError for files.
    """
    session = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    scenes, failed = prepare(bench, datasets, on_event)
    jobs = with_timing(plan(scenes, choice), load_records(bench.records_path), session)
    _say_what_is_left_out(scenes, choice, on_event)
    tables: list[Table] = []

    def write(records: dict[str, Record], failures: dict[str, str]) -> None:
        tables[:] = write_tables(bench, scenes, choice, records, _by_group(jobs, failures), failed)

    by_name = {scene.name: scene for scene in scenes}
    once = partial(execute, bench=bench, choice=choice, scenes=by_name)
    records, failures = carry_out(
        jobs, bench.records_path, once, is_done, parallel=bench.parallel, session=session, on_event=on_event, each=write
    )
    write(records, failures)
    return tables, failed | failures


def prepare(bench: Bench, datasets: Sequence[str], on_event: OnEvent) -> tuple[list[Scene], dict[str, str]]:
    """Preprocess every data set into `OUT/NAME/base`; made rooms are made in `OUT/data`.

    Returns the scenes and, by name, why one could not be had. Raises ConfigError if two have the same name, and what
    went wrong if there is none left.
    """
    named = {}
    for spec in datasets:
        made = synth_arguments(spec)
        name = made[0] if made else scene_name(Path(spec))
        if name in named:
            raise ConfigError(f"two data sets are called {name}; give their folders different names")
        named[name] = (bench.out / "data" / name, made[1]) if made else (Path(spec), None)
    scenes, failed = [], {}
    for name, (folder, synth) in named.items():
        try:
            if synth is not None and not (folder / "synth.json").exists():
                on_event(Note(f"making {name}"))
                process.uncle("synth", folder, "--overwrite", *synth)
            part = ["--frames", bench.frames] if bench.frames else []
            process.uncle("preprocess", folder, "--run", bench.out / name / "base", *part)  # keeps what is up to date
            scenes.append(Scene.of_run(name, bench.out / name / "base"))
        except UncleError as error:
            failed[name] = str(error)
            on_event(Warn(f"{name} is left out: {error}"))
    if not scenes:
        raise ConfigError("; ".join(f"{name}: {reason}" for name, reason in failed.items()) or "no data set was given")
    return scenes, failed


def _say_what_is_left_out(scenes: Sequence[Scene], choice: Choice, on_event: OnEvent) -> None:
    for scene in scenes:
        for names in set(choice.sensors) - set(scene.sensor_sets(choice.sensors)):
            on_event(Note(f"{scene.name} has no {names} ({', '.join(scene.sensors)})"))
        if "given" in choice.settings and not scene.has_poses:
            on_event(Note(f"{scene.name} has no poses: nothing with given poses"))


# --- one pass --------------------------------------------------------------------------------------------------------
def execute(job: Job, bench: Bench, choice: Choice, scenes: dict[str, Scene]) -> Record:
    """Map, mesh and score in a new run directory, each a process of its own. Raises RunError."""
    scene, run = scenes[job.dataset], bench.out / job.dataset / "runs" / re.sub(r"[^\w.+-]+", "_", job.key)
    process.new_run(scene.base, run)
    threads, log = bench.threads, run / "log.txt"
    wall_s = process.uncle("map", "--run", run, *map_options(job, choice), threads=threads, log=log)
    found = job._asdict() | process.map_costs(run, wall_s)
    found |= {"frames_per_s": round(scene.frames / wall_s, 3), "placement": _placement(run, bench)}
    if not job.timed_in:
        metrics = process.evaluate(run, "--protocol", choice.protocol, threads=threads, log=log)
        found |= scores.scores(metrics) | (scores.trajectory_scores(metrics) if job.setting != "given" else {})
    _tidy(run, bench, wanted=not job.timed_in)
    return found


def map_options(job: Job, choice: Choice) -> list[str]:
    """Options of `uncle map` of one job, but for its run."""
    hold_out = ["--hold-out", str(job.hold_out)] if job.hold_out else []
    texts = (*choice.catalogue.settings_of(job.method, job.setting), *choice.overrides_of(job.method), *job.settings)
    settings = [word for text in texts for word in ("--set", text)]
    return [
        "--overwrite", "--method", job.method, *SETTINGS[job.setting][1], *process.sensor_options(job.sensors),
        "--seed", str(job.seed), "--device", choice.device, *hold_out, *settings,
    ]  # fmt: skip


def _placement(run: Path, bench: Bench) -> str:
    """Where the map was made, in words: figures of different places are not alike."""
    beside = f", {bench.parallel} at a time" if bench.parallel > 1 else ""
    cores = bench.threads or len(process.share_of_cores(0, 1))
    return f"{process.map_facts(run).get('device', 'cpu')}, {cores} core{'s' if cores > 1 else ''}{beside}"


def _tidy(run: Path, bench: Bench, wanted: bool) -> None:
    """Leave only the small files of a run that was scored; nothing of one that was only timed."""
    if bench.keep_runs and wanted:
        return
    for item in run.iterdir():
        if item.is_symlink() or not item.is_dir():
            if not wanted or item.name not in KEPT:
                item.unlink()
        else:
            shutil.rmtree(item)
    if not wanted:
        run.rmdir()


# --- results ---------------------------------------------------------------------------------------------------------
def _by_group(jobs: Sequence[Job], failures: dict[str, str]) -> Failures:
    """What to say of failed jobs, by row of a table; seeds that failed alike are told together."""
    seeds: dict[tuple[tuple[str, str, str, str], str], list[str]] = {}
    for job in jobs:
        if job.key in failures and not job.variant:
            row = (job.dataset, job.sensors, job.setting, job.method)
            seeds.setdefault((row, failures[job.key]), []).append(str(job.seed))
    found: Failures = {}
    for (row, reason), failed in seeds.items():
        dataset, sensors = row[:2]
        text = f"on {sensors} of {dataset}, seed {', '.join(failed)} failed: {reason}"
        found.setdefault(row, []).append(text)
    return found


def write_tables(
    bench: Bench, scenes: Sequence[Scene], choice: Choice, records: dict[str, Record], failures: Failures,
    left_out: dict[str, str],
) -> list[Table]:  # fmt: skip
    """Write all tables of what was made as `choice` says, also by earlier calls. Raises RunError."""
    there = {scene.name: scene for scene in scenes}
    mine = [
        record
        for record in records.values()
        if record["dataset"] in there
        and record["made_with"] == choice.digest(there[record["dataset"]], record["method"])
    ]
    tables = paper_tables(scenes, choice, mine, failures)
    if left_out:
        tables.append(Table("Left out", ["data set", "reason"], [[*item] for item in left_out.items()], 2))
    lead = describe_call(scenes, choice)
    failed = [{"row": list(row), "messages": messages} for row, messages in failures.items()]
    facts = {"made_with": lead, "failed": failed, "left_out": left_out, "cores": os.cpu_count()}
    write_text(bench.out / "paper.json", json.dumps(facts | statistics_json(mine), indent=1) + "\n")
    text = "\n\n".join([f"# {TITLE}", lead, *(table.markdown() for table in tables)])
    write_text(bench.out / "paper.md", text + "\n")
    write_text(bench.out / "paper.html", page(TITLE, lead, tables))
    return tables


TITLE = "Methods on one protocol"


def describe_call(scenes: Sequence[Scene], choice: Choice) -> str:
    """One paragraph on what the tables have in common."""
    frames = ", ".join(f"{scene.name} ({scene.frames} frames)" for scene in scenes)
    settings = f" Settings: {', '.join(choice.overrides)}." if choice.overrides else ""
    return (
        f"{frames}. Scored by uncle eval, protocol {choice.protocol}: only what the cameras saw, the same for all "
        f"methods. Medians over the seeds, [minimum, maximum].{settings}"
    )  # fmt: skip
