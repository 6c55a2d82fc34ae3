"""Figures over seeds: mean, median, least, spread, and whether two methods differ."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from .process import Record

SIGNIFICANT = 0.05  # paper: P < 0.05
ALL_SCENES = "all scenes"


class Metric(NamedTuple):
    """How a figure is shown, and which way is better: 1 more, -1 less, 0 neither."""

    heading: str
    key: str
    factor: float
    digits: int
    better: int


Group = tuple[str, ...]


def describe(values: Sequence[float], baseline: Sequence[float], better: int) -> Record:
    """Mean, median, min, max, std (of the sample) of `values`, and Welch's t-test against `baseline`.

    t and p are None where the test is not defined: fewer than two values on a side, or none that differ on both.
    `verdict`: "better", "worse" or "", at `SIGNIFICANT`.
    """
    spread = statistics.stdev(values) if len(values) > 1 else None
    found: Record = {"runs": len(values), "mean": statistics.fmean(values), "median": statistics.median(values)}
    found |= {"min": min(values), "max": max(values), "std": spread, "t": None, "p": None, "verdict": ""}
    return found | welch(values, baseline, better)


def welch(values: Sequence[float], baseline: Sequence[float], better: int) -> Record:
    """t and p of Welch's two-sided test, with the verdict; nothing where it is not defined."""
    from scipy import stats

    if min(len(values), len(baseline)) < 2 or not (statistics.stdev(values) or statistics.stdev(baseline)):
        return {}
    t, p = (float(x) for x in stats.ttest_ind(values, baseline, equal_var=False))
    if not (math.isfinite(t) and math.isfinite(p)):
        return {}
    differs = better and p < SIGNIFICANT
    return {"t": t, "p": p, "verdict": ("better" if t * better > 0 else "worse") if differs else ""}


def collect(
    records: Iterable[Record], metrics: Sequence[Metric], group_of: Callable[[Record], Group]
) -> dict[Group, dict[str, list[float]]]:
    """Values by group and metric. The first name of a group is its data set.

    Where there are several data sets, `ALL_SCENES` has the means of each as its values, which is how the paper tests.
    """
    samples: dict[Group, dict[str, list[float]]] = {}
    for record in records:
        group = group_of(record)
        for metric in metrics:
            if record.get(metric.key) is not None:
                samples.setdefault(group, {}).setdefault(metric.key, []).append(record[metric.key])
    if len({dataset for dataset, *_ in samples}) > 1:
        for (_, *rest), found in list(samples.items()):
            whole = samples.setdefault((ALL_SCENES, *rest), {})
            for key, values in found.items():
                whole.setdefault(key, []).append(statistics.fmean(values))
    return samples


def summarise(
    records: Iterable[Record], metrics: Sequence[Metric], group_of: Callable[[Record], Group], baseline: str,
    names: Sequence[str],
) -> list[Record]:  # fmt: skip
    """One entry per group and metric, tested against the group whose last name is `baseline`. `names` are the keys."""
    samples = collect(records, metrics, group_of)
    rows = []
    for group, found in samples.items():
        against = samples.get((*group[:-1], baseline), {})
        for metric in metrics:
            if metric.key in found:
                other = [] if group[-1] == baseline else against.get(metric.key, [])
                entry = dict(zip(names, group, strict=True)) | {"metric": metric.key}
                rows.append(entry | describe(found[metric.key], other, metric.better))
    return rows
