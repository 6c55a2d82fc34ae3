"""Repeat the whole chain (preprocess, map, mesh, eval) over methods, sensors and seeds; see benchmarks/README.md."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from common import carry_out
from uncle.recon.core.errors import UncleError
from uncle.recon.evaluation.bench.process import Record, evaluate, map_costs, new_run, sensor_options, uncle
from uncle.recon.evaluation.bench.scores import scores
from uncle.recon.evaluation.bench.tables import cell, markdown_table, ratio
from uncle.recon.methods.registry import method_specs

BASELINE = "tsdf"  # knows no seed: scored once, timed BASELINE_TIMES between the other runs
BASELINE_TIMES = 3
# heading, key in the record, factor, digits, whether minimum and maximum are shown
SCENE_COLUMNS = (
    ("F 5 cm %", "f_score_5cm", 100, 2, True), ("F 2 cm %", "f_score_2cm", 100, 2, True),
    ("P 5 cm %", "precision_5cm", 100, 2, False), ("R 5 cm %", "recall_5cm", 100, 2, False),
    ("accuracy cm", "accuracy_mean_m", 100, 2, False), ("held-out L1 cm", "held_out_l1_m", 100, 2, True),
    ("held-out median cm", "held_out_median_m", 100, 2, False), ("held-out seen %", "held_out_seen", 100, 2, False),
    ("held-out PSNR dB", "held_out_psnr_db", 1, 2, False),
    ("map s", "wall_s", 1, 1, False), ("peak MB", "peak_memory_mb", 1, 0, False),
)  # fmt: skip
SENSOR_COLUMNS = (
    ("rank corr.", "rank_correlation", 1, 3, True),
    ("NLL nats", "nll_nats", 1, 3, False), ("NLL constant", "nll_constant_nats", 1, 3, False),
    ("50 % covers %", "coverage_50", 100, 1, False), ("90 % covers %", "coverage_90", 100, 1, False),
    ("calibrated 50 %", "calibrated_coverage_50", 100, 1, False),
    ("calibrated 90 %", "calibrated_coverage_90", 100, 1, False),
    ("AUSE", "ause", 1, 3, False), ("closer than depth alone %", "ause_gain", 100, 1, False),
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


def groups(records: Iterable[Record]) -> dict[tuple[str, ...], list[Record]]:
    """Records that differ in the seed alone, by (data set, sensors, held out, method)."""
    found: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        held_out = f"every {record['hold_out']}" if record["hold_out"] else "-"
        found.setdefault((record["dataset"], record["sensors"] or "all", held_out, record["method"]), []).append(record)
    return found


def markdown(records: Iterable[Record]) -> str:
    """A table of the scenes and, where uncertainty was scored, one of the sensors. Columns without a value are out."""
    found, scene_rows, sensor_rows = groups(records), [], []
    for group, members in found.items():
        baseline, cells = found.get((*group[:3], BASELINE), []), [cell(members, *c[1:]) for c in SCENE_COLUMNS]
        scene_rows.append([*group, str(len(members)), *cells, ratio(members, baseline, "wall_s")])
        for sensor in dict.fromkeys(sensor for member in members for sensor in member.get("uncertainty", {})):
            scored = [member["uncertainty"][sensor] for member in members if sensor in member.get("uncertainty", {})]
            sensor_rows.append([*group, sensor, str(len(scored)), *(cell(scored, *c[1:]) for c in SENSOR_COLUMNS)])
    names = ["data set", "sensors", "held out", "method"]
    scene_header = [*names, "runs", *(column[0] for column in SCENE_COLUMNS), f"time / {BASELINE}"]
    sensor_header = [*names, "sensor", "runs", *(column[0] for column in SENSOR_COLUMNS)]
    return "\n".join(
        [*markdown_table(scene_header, scene_rows), "", *markdown_table(sensor_header, sensor_rows)]
    ).strip()


def execute(job: Job, base: Path, run: Path) -> Record:
    """One pass in the new run directory `run`, which borrows the frames of `base`. Raises RunError."""
    new_run(base, run)
    options = ["--overwrite", "--method", job.method]
    options += sensor_options(job.sensors)
    options += ["--hold-out", str(job.hold_out)] if job.hold_out else []
    wall_s = uncle("map", "--run", run, *options, "--seed", 0 if job.method == BASELINE else job.seed)
    found = job._asdict() | map_costs(run, wall_s)
    if job.method == BASELINE and job.seed > 0:
        return found  # the same map as before: only its time is wanted
    return found | scores(evaluate(run))


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    kinds = parser.add_subparsers(dest="kind", required=True)
    room = kinds.add_parser("room", help="score against the ground truth of the data set")
    heldout = kinds.add_parser("heldout", help="score the depth of frames kept out of the map")
    heldout.add_argument("--every", type=int, default=10, metavar="N", help="keep every N-th frame out [10]")
    for kind in (room, heldout):
        kind.add_argument("dataset", type=Path)
        kind.add_argument("--sensors", nargs="+", default=[""], help="sets of sensors, like: sl sgm sl+psmnet")
        kind.add_argument("--methods", nargs="+", default=["tsdf", "uncle"], choices=list(method_specs()))
        kind.add_argument("--seeds", type=int, default=1, help="number of seeds, from 0 [1]")
        kind.add_argument("--out", type=Path, default=Path("bench-out"), help="results and run directories [bench-out]")
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    name = options.dataset.resolve().name
    base, work = options.out / name / "base", options.out / name / "work"
    jobs = plan(name, options.sensors, options.methods, options.seeds, getattr(options, "every", 0))
    uncle("preprocess", options.dataset, "--run", base)  # keeps frames that are up to date
    once = partial(execute, base=base, run=work)
    records, failed = carry_out(jobs, options.out / "results.json", once, lambda job, record: True)
    print(markdown(records.values()))
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
