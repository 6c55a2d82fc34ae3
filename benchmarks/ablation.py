"""Effect of each choice of the uncertainty: variants over seeds against the unweighted map; see README.md."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from chain import SENSOR_COLUMNS
from common import carry_out
from uncle.recon.core.errors import RunError, UncleError
from uncle.recon.evaluation.bench import statistics
from uncle.recon.evaluation.bench.paper_tables import mean_text
from uncle.recon.evaluation.bench.process import Record, evaluate, map_costs, new_run, sensor_options, uncle
from uncle.recon.evaluation.bench.scores import scores
from uncle.recon.evaluation.bench.statistics import Metric
from uncle.recon.evaluation.bench.tables import cell, markdown_table, number
from uncle.recon.evaluation.bench.variants import GROUPS, METHOD_OF, Settings, choose_variants
from uncle.recon.evaluation.bench.variants import UNWEIGHTED as BASELINE

OWN_GROUPS = [group for group in GROUPS if group not in METHOD_OF]  # of the default method


# --- passes ----------------------------------------------------------------------------------------------------------
class Job(NamedTuple):
    """One map, scored. `settings` are those of the variant when the job was made."""

    dataset: str
    sensors: str  # joined by +; "" are those that `uncle map` takes by itself
    variant: str
    settings: Settings
    seed: int
    track: bool

    @property
    def key(self) -> str:
        return f"{self.dataset}|{self.sensors or 'all'}|{self.variant}|{self.seed}|{'track' if self.track else 'given'}"


def plan(
    datasets: list[str], sensor_sets: list[str], variants: dict[str, Settings], seeds: int, track: bool
) -> list[Job]:
    """Jobs in order: all variants with the first seed, then all with the next, so that one can stop at any time."""
    return [
        Job(dataset, sensors, variant, settings, seed, track)
        for seed in range(seeds)
        for dataset in datasets
        for sensors in sensor_sets
        for variant, settings in variants.items()
    ]


def is_done(job: Job, record: Record) -> bool:
    """Whether `record` is of the same settings: a variant may have changed since."""
    return tuple(record["settings"]) == job.settings


def execute(job: Job, out: Path) -> Record:
    """One pass in a new run directory, which borrows the frames of the data set's base. Raises RunError."""
    run = out / job.dataset / "work"
    new_run(out / job.dataset / "base", run)
    options = ["--overwrite", *sensor_options(job.sensors), "--seed", job.seed, *(["--track"] if job.track else [])]
    wall_s = uncle("map", "--run", run, *options, *(word for text in job.settings for word in ("--set", text)))
    metrics = evaluate(run)
    found = job._asdict() | map_costs(run, wall_s) | scores(metrics)
    if job.track and metrics.get("trajectory"):
        found["ate_m"] = metrics["trajectory"]["ate_m"]["rmse"]
    return found


# --- statistics ------------------------------------------------------------------------------------------------------
METRICS = (
    Metric("F 5 cm %", "f_score_5cm", 100, 2, 1), Metric("F 2 cm %", "f_score_2cm", 100, 2, 1),
    Metric("accuracy cm", "accuracy_mean_m", 100, 3, -1), Metric("depth L1 cm", "depth_l1_m", 100, 3, -1),
    Metric("ATE cm", "ate_m", 100, 3, -1), Metric("map s", "wall_s", 1, 1, 0),
)  # fmt: skip


def summarise(records: Iterable[Record]) -> list[Record]:
    """One entry per data set, set of sensors, variant and metric.

    Where there are several data sets also with their means as samples, which is how the paper tests.
    """

    def group(record: Record) -> tuple[str, str, str]:
        return record["dataset"], record["sensors"] or "all", record["variant"]

    return statistics.summarise(records, METRICS, group, BASELINE, ("dataset", "sensors", "variant"))


# --- tables ----------------------------------------------------------------------------------------------------------
def overview(rows: list[Record]) -> list[str]:
    """The paper's layout: a row per variant, a column per data set, sensors and metric, then how many of them differ.

    Means ± std; + and - mark what is significantly better and worse than the baseline.
    """
    tested = [metric for metric in METRICS if metric.better]
    columns = list(dict.fromkeys((row["dataset"], row["sensors"]) for row in rows))
    by_cell = {(row["dataset"], row["sensors"], row["variant"], row["metric"]): row for row in rows}
    lines = []
    for variant in dict.fromkeys(row["variant"] for row in rows):
        cells = [by_cell.get((*column, variant, metric.key)) for column in columns for metric in tested]
        texts = [mean_text(row, metric) for row, metric in zip(cells, tested * len(columns), strict=True)]
        verdicts = [row["verdict"] for row in cells if row is not None]
        counts = [str(verdicts.count(word)) if variant != BASELINE else "" for word in ("better", "worse")]
        lines.append([variant, *texts, *counts])
    heads = [f"{' '.join(column)}: {metric.heading}" for column in columns for metric in tested]
    return markdown_table(["variant", *heads, "better", "worse"], lines)


def details(rows: list[Record]) -> list[str]:
    """Every figure of `summarise` as a row."""
    metrics = {metric.key: metric for metric in METRICS}
    lines = []
    for row in rows:
        metric = metrics[row["metric"]]
        numbers = [number(row[name], metric.factor, metric.digits) for name in ("mean", "median", "min", "std")]
        tests = [number(row["t"], 1, 2), number(row["p"], 1, 4), row["verdict"]]
        lines.append(
            [row["dataset"], row["sensors"], row["variant"], metric.heading, str(row["runs"]), *numbers, *tests]
        )
    header = ["data set", "sensors", "variant", "figure", "runs", "mean", "median", "min", "std", "t", "p", "verdict"]
    return markdown_table(header, lines)


def sensors_table(records: Iterable[Record]) -> list[str]:
    """How far the uncertainty of each sensor is right, medians over the seeds."""
    found: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        for sensor, figures in record.get("uncertainty", {}).items():
            names = (record["dataset"], record["sensors"] or "all", record["variant"], sensor)
            found.setdefault(names, []).append(figures)
    lines = [[*names, *(cell(figures, *column[1:]) for column in SENSOR_COLUMNS)] for names, figures in found.items()]
    return markdown_table(
        ["data set", "sensors", "variant", "sensor", *(column[0] for column in SENSOR_COLUMNS)], lines
    )


# --- program ---------------------------------------------------------------------------------------------------------
def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("datasets", type=Path, nargs="+", metavar="DATASET")
    parser.add_argument("--sensors", nargs="+", default=[""], help="sets of sensors, like: sl sgm sl+psmnet")
    parser.add_argument("--variants", nargs="+", default=OWN_GROUPS, help="groups or names of variants [all]")
    parser.add_argument(
        "--variant", nargs="+", action="append", default=[], metavar=("NAME", "KEY=VALUE"), help="one of your own"
    )
    parser.add_argument("--seeds", type=int, default=5, help="number of seeds, from 0 [5]")
    parser.add_argument("--track", action="store_true", help="estimate the poses, and score them")
    parser.add_argument("--out", type=Path, default=Path("bench-out"), help="results and run directories [bench-out]")
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    variants = choose_variants(options.variants, options.variant)
    names = [path.resolve().name for path in options.datasets]
    if len(set(names)) < len(names):
        raise RunError("two data sets have the same name; give their folders different ones")
    for path, name in zip(options.datasets, names, strict=True):
        uncle("preprocess", path, "--run", options.out / name / "base")  # keeps frames that are up to date
    jobs = plan(names, options.sensors, variants, options.seeds, options.track)
    passes = options.out / "ablation.json"
    records, failed = carry_out(jobs, passes, lambda job: execute(job, options.out), is_done)
    done = [records[job.key] for job in jobs if job.key in records and job.key not in failed]
    rows = summarise(done)
    text = "\n\n".join("\n".join(part) for part in (overview(rows), details(rows), sensors_table(done)) if part)
    (options.out / "ablation_statistics.json").write_text(json.dumps(rows, indent=1) + "\n")
    (options.out / "ablation.md").write_text(text + "\n")
    print(text)
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
