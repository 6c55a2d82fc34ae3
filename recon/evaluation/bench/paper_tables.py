"""The tables of `uncle bench paper`, and the same figures as JSON."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from typing import Any

from . import methods, scores
from .plan import SETTINGS, Choice, Scene, possible_settings
from .process import Record
from .published import MEANING, published
from .statistics import ALL_SCENES, Metric, collect, describe, summarise
from .tables import NOTHING, Table, cell, number, ratio, spread
from .variants import UNWEIGHTED

_COUNTS = {1: "Single sensor", 2: "Two sensors", 3: "Three sensors"}
_RANGED = {"f_score_5cm", "f_score_2cm", "depth_l1_m", "held_out_l1_m", "ate_m", "ate_aligned_m"}
_TESTED = tuple(metric for metric in (*scores.SURFACE, *scores.TRAJECTORY) if metric.key in _RANGED)
_SHOWN = (*scores.SURFACE, *scores.TRAJECTORY)
DETAILS = "All figures"  # long: for files, not for the screen
_NAMES = ("dataset", "sensors", "setting", "method")
Failures = dict[tuple[str, str, str, str], list[str]]  # data set, sensors, setting, method -> messages


def group_of(record: Record) -> tuple[str, ...]:
    """Data set, sensors, setting and method of `record`."""
    return tuple(record[name] for name in _NAMES)


def paper_tables(scenes: Sequence[Scene], choice: Choice, records: Iterable[Record], failures: Failures) -> list[Table]:
    """Every table that has a row. `records` are those of `scenes` that were made as `choice` says."""
    records = list(records)
    plain = [record for record in records if not record["variant"]]
    scored = [record for record in plain if not record["timed_in"]]
    tables = [
        table
        for setting in choice.settings
        for count in sorted(
            {sensors.count("+") + 1 for scene in scenes for sensors in scene.sensor_sets(choice.sensors)}
        )
        if (table := _scene_table(scenes, choice, setting, count, scored, failures)).rows
    ]
    tables += [_tests(scored), _trust(choice, scored), _costs(plain), _ablation(records), _details(scored)]
    return [table for table in tables if table.rows or table.notes]


def statistics_json(records: Iterable[Record]) -> dict[str, Any]:
    """Statistics of every figure and the tests, in SI units and ratios 0..1."""
    records = list(records)
    scored = [record for record in records if not record["variant"] and not record["timed_in"]]
    samples = collect(scored, (*_SHOWN, *scores.COSTS), group_of)
    figures = [
        dict(zip(_NAMES, group, strict=True)) | {"figure": key} | _plain(describe(values, [], 0))
        for group, found in samples.items()
        for key, values in found.items()
    ]
    uncertainty = [
        dict(zip((*_NAMES, "sensor"), group, strict=True)) | {"figure": key} | _plain(describe(values, [], 0))
        for group, found in collect(_by_sensor(scored), scores.TRUST, lambda r: (*group_of(r), r["sensor"])).items()
        for key, values in found.items()
    ]
    return {"figures": figures, "uncertainty": uncertainty, "tests": _welch(scored), "ablation": _ablated(records)}


def _plain(found: Record) -> Record:
    return {key: found[key] for key in ("runs", "mean", "median", "min", "max", "std")}


# --- scenes ----------------------------------------------------------------------------------------------------------
def _scene_table(
    scenes: Sequence[Scene], choice: Choice, setting: str, count: int, records: list[Record], failures: Failures
) -> Table:
    """Rows of one setting and number of sensors: every data set and method, also those that have nothing to say."""
    samples = collect(records, _SHOWN, group_of)
    rows: list[list[str]] = []
    notes: list[str] = []
    formats = {scene.name: scene.format for scene in scenes}
    for dataset, sensors in _columns(scenes, choice, setting, count):
        for method in _methods(choice, records):
            group = (dataset, sensors, setting, method)
            found, remarks = samples.get(group, {}), _remarks(choice, group, failures)
            if not found and not remarks:
                continue
            marks = [_mark(notes, f"{method}: {remark}") for remark in remarks]
            runs = max(map(len, found.values()), default=0)
            best = _best(samples, group)
            figures = [_figure(found.get(m.key, []), m, dataset, m.key in best) for m in _SHOWN]
            reference = published(dataset, formats.get(dataset, ""), setting, sensors, method)
            rows.append([dataset, sensors, " ".join([method, *marks]), str(runs), *figures, reference])
    header = ["data set", "sensors", "method", "runs", *(metric.heading for metric in _SHOWN), "paper"]
    if any(row[-1] != NOTHING for row in rows):
        notes.append(MEANING)
    if any(cell.endswith(" *") for row in rows for cell in row):
        notes.append("The mark * means that no other method is better in this figure on these sensors.")
    title = f"{_COUNTS.get(count, f'{count} sensors')}, {SETTINGS[setting][0]}"
    return Table(title, header, rows, 3, notes)


def _columns(scenes: Sequence[Scene], choice: Choice, setting: str, count: int) -> list[tuple[str, str]]:
    """(data set, sensors) of the table; a set that several data sets have is summed up at the end."""
    pairs = [
        (scene.name, sensors)
        for scene in scenes
        if setting in possible_settings(scene, choice.settings)
        for sensors in scene.sensor_sets(choice.sensors)
        if sensors.count("+") + 1 == count
    ]
    sets = [sensors for _, sensors in pairs]
    return pairs + [(ALL_SCENES, sensors) for sensors in dict.fromkeys(sets) if sets.count(sensors) > 1]


def _methods(choice: Choice, records: list[Record]) -> list[str]:
    """In the usual order, also those of earlier calls."""
    return choice.catalogue.in_order([*choice.methods, *(record["method"] for record in records)])


def _remarks(choice: Choice, group: tuple[str, str, str, str], failures: Failures) -> list[str]:
    dataset, _, setting, method = group
    reason = choice.catalogue.why_not(method, setting)
    if reason is not None and dataset != ALL_SCENES:
        return [reason]
    return failures.get(group, [])


def _mark(notes: list[str], text: str) -> str:
    """The footnote that says `text`, added if it is new."""
    known = [note.partition("] ")[2] for note in notes]
    if text not in known:
        notes.append(f"[{len(notes) + 1}] {text}")
        known.append(text)
    return f"[{known.index(text) + 1}]"


def _figure(values: list[float], metric: Metric, dataset: str, is_best: bool) -> str:
    """Median over the seeds with its range; over data sets the mean of their means."""
    mark = " *" if is_best else ""
    if dataset == ALL_SCENES and values:
        return f"mean {number(statistics.fmean(values), metric.factor, metric.digits)}{mark}"
    return spread(values, metric.factor, metric.digits, metric.key in _RANGED) + mark


def _best(samples: dict[tuple[str, ...], dict[str, list[float]]], group: tuple[str, ...]) -> set[str]:
    """Figures in which no method is better than that of `group` on the same sensors, where there are several."""
    rivals = [found for name, found in samples.items() if name[:-1] == group[:-1]]
    middle = statistics.fmean if group[0] == ALL_SCENES else statistics.median
    keys = set()
    for metric in _SHOWN:
        values = [metric.better * middle(found[metric.key]) for found in rivals if metric.key in found]
        own = samples.get(group, {}).get(metric.key)
        if metric.better and own and len(values) > 1 and metric.better * middle(own) >= max(values):
            keys.add(metric.key)
    return keys


# --- tests -----------------------------------------------------------------------------------------------------------
def _welch(records: list[Record]) -> list[Record]:
    """Welch's test of every pair of methods of interest, by group and figure, where it is defined."""
    samples = collect(records, _TESTED, group_of)
    pairs = methods.tested_pairs(list(dict.fromkeys(group[-1] for group in samples)))
    places = list(dict.fromkeys(group[:-1] for group in samples))
    rows = []
    for (method, against), place, metric in ((a, b, c) for a in pairs for b in places for c in _TESTED):
        ours, theirs = (samples.get((*place, name), {}).get(metric.key, []) for name in (method, against))
        if not ours or not theirs:
            continue
        found, other = describe(ours, theirs, metric.better), describe(theirs, [], metric.better)
        if found["p"] is not None:
            names = dict(zip((*_NAMES, "against"), (*place, method, against), strict=True))
            rows.append(
                names | {"figure": metric.key, "mean_against": other["mean"], "std_against": other["std"]} | found
            )
    return rows


def _tests(records: list[Record]) -> Table:
    by_key, rows = {metric.key: metric for metric in _TESTED}, []
    for test in _welch(records):
        metric = by_key[test["figure"]]
        means = [
            f"{number(test[a], metric.factor, metric.digits)} ± {number(test[b], metric.factor, metric.digits)}"
            for a, b in (("mean", "std"), ("mean_against", "std_against"))
        ]
        names = [test[name] for name in ("dataset", "sensors", "setting", "method", "against")]
        verdict = test["verdict"] or "no difference shown"
        rows.append([*names, metric.heading, *means, number(test["t"], 1, 2), number(test["p"], 1, 4), verdict])
    header = ["data set", "sensors", "setting", "method", "against", "figure", "mean ± std", "of the other", "t", "p"]
    note = (
        "Welch's two-sided t-test over the seeds, unequal variances; over all scenes, of the means of the data sets, "
        "as in the paper. One test in twenty has p below 0.05 by chance."
    )  # fmt: skip
    missing = "No test: it takes two runs of each method and a spread among them; raise --seeds."
    return Table("Do methods differ?", [*header, "verdict"], rows, 6, [note if rows else missing] if records else [])


# --- uncertainty, costs, ablation, all figures -----------------------------------------------------------------------
def _by_sensor(records: Iterable[Record]) -> list[Record]:
    return [
        {name: record[name] for name in (*_NAMES, "variant")} | {"sensor": sensor} | figures
        for record in records
        for sensor, figures in record.get("uncertainty", {}).items()
    ]


def _trust(choice: Choice, records: list[Record]) -> Table:
    """How far the stated beta of each sensor is right."""
    found: dict[tuple[str, ...], list[Record]] = {}
    for record in _by_sensor(records):
        found.setdefault((*group_of(record), record["sensor"]), []).append(record)
    rows = [
        [*group, str(len(members)), *(cell(members, m.key, m.factor, m.digits, m.better != 0) for m in scores.TRUST)]
        for group, members in found.items()
    ]
    header = ["data set", "mapped", "setting", "method", "sensor", "runs", *(metric.heading for metric in scores.TRUST)]
    without = choice.catalogue.in_order({r["method"] for r in records} - {group[3] for group in found})
    note = (
        "Likelihoods and AUSE are better when lower. Without a row, because they state no uncertainty or none could be "
    )
    notes = [f"{note}scored: {', '.join(without)}." if without else note.split(" Without")[0]]
    return Table("Is the stated uncertainty right?", header, rows, 5, notes if rows else [])


def _costs(records: list[Record]) -> Table:
    found: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        found.setdefault(group_of(record), []).append(record)
    rows = [
        [
            *group, str(len(members)), *(cell(members, m.key, m.factor, m.digits, False) for m in scores.COSTS),
            ratio(members, found.get((*group[:-1], methods.BASELINE), []), "wall_s"),
            ", ".join(dict.fromkeys(str(member.get("placement", NOTHING)) for member in members)),
        ]
        for group, members in found.items()
    ]  # fmt: skip
    header = [*_HEADS, "timed", *(m.heading for m in scores.COSTS), f"time / {methods.BASELINE}", "where"]
    note = (
        "Whole processes of `uncle map`, start-up included; medians. The ratio is of medians, over calls that timed "
        "both. Times mean something only on a machine that does nothing else."
    )  # fmt: skip
    return Table("Time and memory", header, rows, 4, [note] if rows else [])


_HEADS = ("data set", "sensors", "setting", "method")


def _ablated(records: Iterable[Record]) -> list[Record]:
    def group(record: Record) -> tuple[str, ...]:
        return *group_of(record), record["variant"]

    names = (*_NAMES, "variant")
    return summarise((r for r in records if r["variant"]), _TESTED, group, UNWEIGHTED, names)


def _ablation(records: Iterable[Record]) -> Table:
    found = {(*group_of(row), row["variant"], row["metric"]): row for row in _ablated(records)}
    rows = []
    for group in dict.fromkeys(key[:-1] for key in found):
        cells = [found.get((*group, metric.key)) for metric in _TESTED]
        rows.append([*group, *(mean_text(row, metric) for row, metric in zip(cells, _TESTED, strict=True))])
    note = (
        f"Means ± std; + and - mark what differs from `{UNWEIGHTED}` (Welch, p < 0.05). docs/bench.md has the variants."
    )
    header = [*_HEADS, "variant", *(metric.heading for metric in _TESTED)]
    return Table("Ablation of the uncertainty", header, rows, 5, [note] if rows else [])


def mean_text(row: Record | None, metric: Metric) -> str:
    """Mean ± std of an entry of `summarise`, with + where it is better than the baseline and - where it is worse."""
    if row is None:
        return NOTHING
    mean, std = (number(row[name], metric.factor, metric.digits) for name in ("mean", "std"))
    mark = {"better": " +", "worse": " -", "": ""}[row["verdict"]]
    return (mean if row["std"] is None else f"{mean} ± {std}") + mark


def _details(records: list[Record]) -> Table:
    samples = collect(records, (*_SHOWN, *scores.COSTS), group_of)
    rows = []
    for group, found in samples.items():
        for metric in (*_SHOWN, *scores.COSTS):
            if metric.key in found:
                row = describe(found[metric.key], [], 0)
                figures = [
                    number(row[n], metric.factor, metric.digits) for n in ("mean", "median", "min", "max", "std")
                ]
                rows.append([*group, metric.heading, str(row["runs"]), *figures])
    header = [*_HEADS, "figure", "runs", "mean", "median", "min", "max", "std"]
    return Table(DETAILS, header, rows, 5)
