"""Repeat the whole chain (preprocess, map, mesh, eval) over methods, sensors and seeds; see benchmarks/README.md."""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

Record = dict[str, Any]
UNCLE = Path(sys.executable).with_name("uncle")
BASELINE = "tsdf"  # knows no seed: scored once, timed BASELINE_TIMES between the other runs
BASELINE_TIMES = 3
UNCERTAINTY = ("rank_correlation", "nll_nats", "nll_constant_nats", "coverage_50", "coverage_90")
# heading, key in the record, factor, digits, whether minimum and maximum are shown
SCENE_COLUMNS = (
    ("F 5 cm %", "f_score_5cm", 100, 2, True), ("F 2 cm %", "f_score_2cm", 100, 2, True),
    ("P 5 cm %", "precision_5cm", 100, 2, False), ("R 5 cm %", "recall_5cm", 100, 2, False),
    ("accuracy cm", "accuracy_mean_m", 100, 2, False), ("held-out L1 cm", "held_out_l1_m", 100, 2, True),
    ("held-out median cm", "held_out_median_m", 100, 2, False), ("held-out seen %", "held_out_seen", 100, 2, False),
    ("map s", "wall_s", 1, 1, False), ("peak MB", "peak_memory_mb", 1, 0, False),
)  # fmt: skip
SENSOR_COLUMNS = (
    ("rank corr.", "rank_correlation", 1, 3, True),
    ("NLL nats", "nll_nats", 1, 3, False), ("NLL constant", "nll_constant_nats", 1, 3, False),
    ("50 % covers %", "coverage_50", 100, 1, False), ("90 % covers %", "coverage_90", 100, 1, False),
)  # fmt: skip


class Job(NamedTuple):
    """One pass through the chain. `seed` counts the repetitions where the method knows no seed."""

    dataset: str
    sensors: str  # joined by +; "" are those that `uncle map` takes by itself
    method: str
    seed: int
    hold_out: int  # 0: none

    @property
    def key(self) -> str:
        return f"{self.dataset}|{self.sensors or 'all'}|{self.method}|{self.seed}|{self.hold_out}"


def plan(dataset: str, sensor_sets: list[str], methods: list[str], seeds: int, hold_out: int) -> list[Job]:
    """Jobs in order: methods take turns, so that a change in the load of the machine meets all of them."""
    rounds = {method: BASELINE_TIMES if method == BASELINE else seeds for method in methods}
    return [
        Job(dataset, sensors, method, turn, hold_out)
        for sensors in sensor_sets
        for turn in range(max(rounds.values()))
        for method in methods
        if turn < rounds[method]
    ]


def scores(metrics: Record) -> Record:
    """The figures of `RUN/metrics.json` that are compared, flat; SI units, ratios 0..1. What was not scored is out."""
    found: Record = {}
    if metrics.get("surface"):
        mesh = metrics["surface"]["mesh"]
        for score in mesh["scores"]:
            at = f"{round(score['threshold_m'] * 100)}cm"
            found |= {f"{name}_{at}": score[name] for name in ("f_score", "precision", "recall")}
        found["accuracy_mean_m"] = mesh["accuracy_mean_m"]
    for depth in list(metrics.get("held_out", {}).values())[:1]:  # gt where there is one, else the first sensor
        found |= {"held_out_l1_m": depth["l1_m"], "held_out_median_m": depth["median_m"]}
        found |= {"held_out_seen": depth["completeness"], "held_out_sensor": depth["sensor"]}
    return found | {"uncertainty": {s: {n: u[n] for n in UNCERTAINTY} for s, u in metrics["uncertainty"].items()}}


def groups(records: Iterable[Record]) -> dict[tuple[str, ...], list[Record]]:
    """Records that differ in the seed alone, by (data set, sensors, held out, method)."""
    found: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        held_out = f"every {record['hold_out']}" if record["hold_out"] else "-"
        found.setdefault((record["dataset"], record["sensors"] or "all", held_out, record["method"]), []).append(record)
    return found


def cell(records: list[Record], key: str, factor: float, digits: int, with_range: bool) -> str:
    """Median over the records that have `key`, with [minimum, maximum] if asked; "-" if none has."""
    values = [record[key] * factor for record in records if record.get(key) is not None]
    if not values:
        return "-"
    middle = f"{statistics.median(values):.{digits}f}"
    return (
        f"{middle} [{min(values):.{digits}f}, {max(values):.{digits}f}]" if with_range and len(values) > 1 else middle
    )


def time_ratio(records: list[Record], baseline: list[Record]) -> str:
    """Median seconds over the median of the baseline, from invocations of this script that timed both; else "-"."""
    shared = {record["session"] for record in records} & {record["session"] for record in baseline}
    ours, theirs = ([r["wall_s"] for r in part if r["session"] in shared] for part in (records, baseline))
    return f"{statistics.median(ours) / statistics.median(theirs):.2f}" if shared else "-"


def markdown(records: Iterable[Record]) -> str:
    """A table of the scenes and, where uncertainty was scored, one of the sensors. Columns without a value are out."""
    found, scene_rows, sensor_rows = groups(records), [], []
    for group, members in found.items():
        baseline, cells = found.get((*group[:3], BASELINE), []), [cell(members, *c[1:]) for c in SCENE_COLUMNS]
        scene_rows.append([*group, str(len(members)), *cells, time_ratio(members, baseline)])
        for sensor in dict.fromkeys(sensor for member in members for sensor in member.get("uncertainty", {})):
            scored = [member["uncertainty"][sensor] for member in members if sensor in member.get("uncertainty", {})]
            sensor_rows.append([*group, sensor, str(len(scored)), *(cell(scored, *c[1:]) for c in SENSOR_COLUMNS)])
    names = ["data set", "sensors", "held out", "method"]
    scene_header = [*names, "runs", *(column[0] for column in SCENE_COLUMNS), f"time / {BASELINE}"]
    sensor_header = [*names, "sensor", "runs", *(column[0] for column in SENSOR_COLUMNS)]
    return "\n".join([*_table(scene_header, scene_rows), "", *_table(sensor_header, sensor_rows)]).strip()


def _table(header: list[str], rows: list[list[str]]) -> list[str]:
    kept = [column for column in range(len(header)) if any(row[column] != "-" for row in rows)]
    lines = [[header[column] for column in kept], ["---"] * len(kept), *([row[c] for c in kept] for row in rows)]
    return ["| " + " | ".join(line) + " |" for line in lines] if rows else []


def uncle(*arguments: object) -> float:
    """Run `uncle`; wall seconds of the process. Raises RuntimeError with the last line it printed if it failed."""
    began = time.perf_counter()
    done = subprocess.run([str(UNCLE), *map(str, arguments)], capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
        raise RuntimeError(f"uncle {arguments[0]}: {last}")
    return round(time.perf_counter() - began, 2)


def execute(job: Job, base: Path, run: Path) -> Record:
    """One pass in the new run directory `run`, which borrows the frames of `base`. Raises RuntimeError."""
    shutil.rmtree(run, ignore_errors=True)  # beta maps of an earlier job must not be scored again
    run.mkdir(parents=True)
    (run / "frames").symlink_to((base / "frames").resolve(), target_is_directory=True)
    for file in base.glob("*.*"):
        shutil.copy(file, run)  # manifest and reference trajectory
    options = ["--overwrite", "--method", job.method]
    options += ["--sensors", *job.sensors.split("+")] if job.sensors else []
    options += ["--hold-out", str(job.hold_out)] if job.hold_out else []
    wall_s = uncle("map", "--run", run, *options, "--seed", 0 if job.method == BASELINE else job.seed)
    facts = json.loads((run / "manifest.json").read_text())["stages"]["map"]["facts"]
    costs = {"wall_s": wall_s, "stage_seconds": facts["seconds"], "peak_memory_mb": facts["peak_memory_mb"]}
    if job.method == BASELINE and job.seed > 0:
        return job._asdict() | costs  # the same map as before: only its time is wanted
    uncle("mesh", "--run", run, "--overwrite")
    uncle("eval", "--run", run, "--json")
    return job._asdict() | costs | scores(json.loads((run / "metrics.json").read_text()))


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    kinds = parser.add_subparsers(dest="kind", required=True)
    room = kinds.add_parser("room", help="score against the ground truth of the data set")
    heldout = kinds.add_parser("heldout", help="score the depth of frames kept out of the map")
    heldout.add_argument("--every", type=int, default=10, metavar="N", help="keep every N-th frame out [10]")
    for kind in (room, heldout):
        kind.add_argument("dataset", type=Path)
        kind.add_argument("--sensors", nargs="+", default=[""], help="sets of sensors, like: sl sgm sl+psmnet")
        kind.add_argument("--methods", nargs="+", default=["tsdf", "uncle"], choices=["tsdf", "uncle"])
        kind.add_argument("--seeds", type=int, default=1, help="number of seeds, from 0 [1]")
        kind.add_argument("--out", type=Path, default=Path("bench-out"), help="results and run directories [bench-out]")
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    name, session = options.dataset.resolve().name, time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    base, results_path, part = (options.out / path for path in (f"{name}/base", "results.json", "results.part"))
    records: dict[str, Record] = json.loads(results_path.read_text()) if results_path.exists() else {}
    jobs = plan(name, options.sensors, options.methods, options.seeds, getattr(options, "every", 0))
    missing, failed = [job for job in jobs if job.key not in records], 0
    uncle("preprocess", options.dataset, "--run", base)  # keeps frames that are up to date
    for number, job in enumerate(missing, start=1):
        print(f"[{number}/{len(missing)}] {job.key}", file=sys.stderr, flush=True)
        try:
            record = execute(job, base, options.out / name / "work")
        except RuntimeError as error:
            failed += 1
            print(f"failed, to be tried again by the next call: {error}", file=sys.stderr)
            continue
        records[job.key] = record | {"session": session, "machine": f"{platform.machine()}, {os.cpu_count()} cores"}
        part.write_text(json.dumps(records, indent=1) + "\n")
        part.replace(results_path)  # never half a file
    print(markdown(records.values()))
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (RuntimeError, OSError) as error:
        sys.exit(f"error: {error}")
