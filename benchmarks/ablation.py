"""What each choice of the uncertainty is worth: variants over seeds against the unweighted map; see README.md."""

from __future__ import annotations

import argparse
import json
import math
import statistics
import sys
from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

from chain import SENSOR_COLUMNS, evaluate, map_costs, scores
from common import Record, carry_out, cell, new_run, sensor_options, table, uncle
from scipy import stats

BASELINE = "unweighted"
SIGNIFICANT = 0.05  # paper: P < 0.05
ALL_SCENES = "all scenes"
Settings = tuple[str, ...]  # key=value, as `uncle map --set` takes them


# --- variants --------------------------------------------------------------------------------------------------------
_TWO, _SEVEN = ("depth", "incidence"), ("depth", "incidence", "slope_x", "slope_y")
_PATCH = {kind: tuple(f"{kind}_{window}" for window in (3, 7)) for kind in ("spread", "offset", "holes")}


def _features(*names: str) -> str:
    return f"uncertainty.features={json.dumps(names)}"


def _paper_variants() -> dict[str, Settings]:
    """The paper's eight: patch of 1 or 5 pixels, 2 or 7 features, small or large beta_min, as far as settings go.

    A patch is what summarises one here. The normal of the seven follows from incidence and both slopes.
    """
    patch = tuple(name for names in _PATCH.values() for name in names)
    seen = {"1K2F": _TWO, "1K7F": _SEVEN, "5K2F": (*_TWO, *patch), "5K7F": (*_SEVEN, *patch, "bend")}
    small_large = {"S": "uncertainty.beta_min_m=1e-3", "L": "uncertainty.beta_min_m=1e-1"}
    return {f"{a}{b}": (_features(*seen[a]), small_large[b]) for a, b in product(seen, small_large)}


GROUPS: dict[str, dict[str, Settings]] = {
    "paper": _paper_variants(),
    "own": {
        "uncle": (),
        "two inputs": (_features(*_TWO),),
        "hidden 8": ("uncertainty.hidden=8",),
        "hidden 64": ("uncertainty.hidden=64",),
        "sweeps 0": ("fusion.sweeps=0",),
        "sweeps 1": ("fusion.sweeps=1",),
        "sweeps 2": ("fusion.sweeps=2",),
        "quarter of the steps": ("uncertainty.steps_per_sweep=100",),
        "no blur": ("fusion.blur_voxels=0",),
        "beta_min 1 cm": ("uncertainty.beta_min_m=1e-2",),
        "no refinement": ("field.iterations=0",),
    },
}
UNWEIGHTED: Settings = ("uncertainty.enabled=false",)


def choose_variants(names: Sequence[str], added: Sequence[Sequence[str]] = ()) -> dict[str, Settings]:
    """Variants by name, the baseline first: groups or single ones, and `added` as (name, setting, ...).

    Raises RuntimeError for a name that there is not.
    """
    known = {name: settings for group in GROUPS.values() for name, settings in group.items()}
    chosen: dict[str, Settings] = {BASELINE: UNWEIGHTED}
    for name in names:
        if name not in GROUPS and name not in known and name != BASELINE:
            raise RuntimeError(f"no variant or group is called {name!r}; there are {', '.join((*GROUPS, *known))}")
        chosen |= GROUPS.get(name) or ({name: known[name]} if name in known else {})
    return chosen | {name: tuple(settings) for name, *settings in added}


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
    """One pass in a new run directory, which borrows the frames of the data set's base. Raises RuntimeError."""
    run = out / job.dataset / "work"
    new_run(out / job.dataset / "base", run)
    options = ["--overwrite", *sensor_options(job.sensors), "--seed", job.seed, *(["--track"] if job.track else [])]
    wall_s = uncle("map", "--run", run, *options, *(word for text in job.settings for word in ("--set", text)))
    metrics = evaluate(run)
    found = job._asdict() | map_costs(run, wall_s) | scores(metrics)
    if views := (metrics.get("surface") or {}).get("novel_views"):
        found["depth_l1_m"] = views["l1_all_m"]
    if job.track and metrics.get("trajectory"):
        found["ate_m"] = metrics["trajectory"]["ate_m"]["rmse"]
    return found


# --- statistics ------------------------------------------------------------------------------------------------------
class Metric(NamedTuple):
    """How a figure is shown, and which way is better: 1 more, -1 less, 0 neither."""

    heading: str
    key: str
    factor: float
    digits: int
    better: int


METRICS = (
    Metric("F 5 cm %", "f_score_5cm", 100, 2, 1), Metric("F 2 cm %", "f_score_2cm", 100, 2, 1),
    Metric("accuracy cm", "accuracy_mean_m", 100, 3, -1), Metric("depth L1 cm", "depth_l1_m", 100, 3, -1),
    Metric("ATE cm", "ate_m", 100, 3, -1), Metric("map s", "wall_s", 1, 1, 0),
)  # fmt: skip


def describe(values: Sequence[float], baseline: Sequence[float], better: int) -> Record:
    """Mean, median, min, std (of the sample) of `values`, and Welch's t-test against `baseline`.

    t and p are None where the test is not defined: fewer than two values on a side, or none that differ on both.
    `verdict`: "better", "worse" or "", at `SIGNIFICANT`.
    """
    spread = statistics.stdev(values) if len(values) > 1 else None
    found: Record = {"runs": len(values), "mean": statistics.fmean(values), "median": statistics.median(values)}
    found |= {"min": min(values), "std": spread, "t": None, "p": None, "verdict": ""}
    if min(len(values), len(baseline)) < 2 or not (spread or statistics.stdev(baseline)):
        return found
    t, p = (float(x) for x in stats.ttest_ind(values, baseline, equal_var=False))
    if math.isfinite(t) and math.isfinite(p):
        found |= {"t": t, "p": p}
        if better and p < SIGNIFICANT:
            found["verdict"] = "better" if t * better > 0 else "worse"
    return found


def summarise(records: Iterable[Record]) -> list[Record]:
    """One entry per data set, set of sensors, variant and metric.

    Where there are several data sets also with their means as samples, which is how the paper tests.
    """
    samples: dict[tuple[str, str, str], dict[str, list[float]]] = {}
    for record in records:
        names = (record["dataset"], record["sensors"] or "all", record["variant"])
        for metric in METRICS:
            if record.get(metric.key) is not None:
                samples.setdefault(names, {}).setdefault(metric.key, []).append(record[metric.key])
    if len({dataset for dataset, _, _ in samples}) > 1:
        for (_, sensors, variant), found in list(samples.items()):
            whole = samples.setdefault((ALL_SCENES, sensors, variant), {})
            for key, values in found.items():
                whole.setdefault(key, []).append(statistics.fmean(values))
    rows = []
    for (dataset, sensors, variant), found in samples.items():
        baseline = samples.get((dataset, sensors, BASELINE), {})
        for metric in METRICS:
            if metric.key in found:
                other = [] if variant == BASELINE else baseline.get(metric.key, [])
                names = {"dataset": dataset, "sensors": sensors, "variant": variant, "metric": metric.key}
                rows.append(names | describe(found[metric.key], other, metric.better))
    return rows


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
        texts = [_mean(row, metric) for row, metric in zip(cells, tested * len(columns), strict=True)]
        verdicts = [row["verdict"] for row in cells if row is not None]
        counts = [str(verdicts.count(word)) if variant != BASELINE else "" for word in ("better", "worse")]
        lines.append([variant, *texts, *counts])
    heads = [f"{' '.join(column)}: {metric.heading}" for column in columns for metric in tested]
    return table(["variant", *heads, "better", "worse"], lines)


def details(rows: list[Record]) -> list[str]:
    """Every figure of `summarise` as a row."""
    metrics = {metric.key: metric for metric in METRICS}
    lines = []
    for row in rows:
        metric = metrics[row["metric"]]
        numbers = [_number(row[name], metric.factor, metric.digits) for name in ("mean", "median", "min", "std")]
        tests = [_number(row["t"], 1, 2), _number(row["p"], 1, 4), row["verdict"]]
        lines.append(
            [row["dataset"], row["sensors"], row["variant"], metric.heading, str(row["runs"]), *numbers, *tests]
        )
    header = ["data set", "sensors", "variant", "figure", "runs", "mean", "median", "min", "std", "t", "p", "verdict"]
    return table(header, lines)


def sensors_table(records: Iterable[Record]) -> list[str]:
    """How far the uncertainty of each sensor is right, medians over the seeds."""
    found: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        for sensor, figures in record.get("uncertainty", {}).items():
            names = (record["dataset"], record["sensors"] or "all", record["variant"], sensor)
            found.setdefault(names, []).append(figures)
    lines = [[*names, *(cell(figures, *column[1:]) for column in SENSOR_COLUMNS)] for names, figures in found.items()]
    return table(["data set", "sensors", "variant", "sensor", *(column[0] for column in SENSOR_COLUMNS)], lines)


def _mean(row: Record | None, metric: Metric) -> str:
    if row is None:
        return "-"
    mean, spread = (_number(row[name], metric.factor, metric.digits) for name in ("mean", "std"))
    mark = {"better": " +", "worse": " -", "": ""}[row["verdict"]]
    return (mean if row["std"] is None else f"{mean} ± {spread}") + mark


def _number(value: float | None, factor: float, digits: int) -> str:
    return "-" if value is None else f"{value * factor:.{digits}f}"


# --- program ---------------------------------------------------------------------------------------------------------
def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("datasets", type=Path, nargs="+", metavar="DATASET")
    parser.add_argument("--sensors", nargs="+", default=[""], help="sets of sensors, like: sl sgm sl+psmnet")
    parser.add_argument("--variants", nargs="+", default=list(GROUPS), help="groups or names of variants [all]")
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
        raise RuntimeError("two data sets have the same name; give their folders different ones")
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
    except (RuntimeError, OSError) as error:
        sys.exit(f"error: {error}")
