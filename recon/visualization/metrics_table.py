"""Nested JSON values as table rows: the unit of a value follows from the ending of its name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ..core.number_format import format_grouped

_RATIOS = {"precision", "recall", "f_score", "completeness", "coverage_50", "coverage_90", "ratio"} | {
    "calibrated_coverage_50", "calibrated_coverage_90", "coverage_1_sigma", "coverage_2_sigma", "ause_gain",
}  # fmt: skip
_UNITS = (  # suffix of a name -> (factor, unit, digits)
    ("_rad_per_m", math.degrees(1.0), "°/m", 2),
    ("_m_per_s", 100.0, "cm/s", 3),
    ("_per_s", 1.0, "1/s", 1),
    ("_deg", 1.0, "°", 2),
    ("_rad", math.degrees(1.0), "°", 2),
    ("_mb", 1.0, "MB", 0),
    ("_bytes", 1e-6, "MB", 0),
    ("_nats", 1.0, "nats", 3),
    ("_ratio", 100.0, "%", 1),
    ("_s", 1.0, "s", 2),
    ("_m", 100.0, "cm", 2),
)
_LONGEST_LIST = 8


@dataclass(frozen=True)
class Row:
    """One value: its group, its name, the value and its unit as text."""

    group: str
    name: str
    value: str
    unit: str


def metric_rows(metrics: Any, group: str = "", unit_key: str = "") -> list[Row]:
    """Every number, word and short list of nested dictionaries; the values of a group stand before its subgroups.

    Long lists (curves) are left out. A value whose name has no unit takes that of `unit_key`, the name of its group:
    `{"ate_m": {"rmse": 0.01}}` is in metres.
    """
    rows: list[Row] = []
    groups: list[Row] = []
    items = metrics.items() if isinstance(metrics, dict) else _named(metrics)
    for key, value in items:
        name = readable(str(key))
        if isinstance(value, dict) or (isinstance(value, list) and any(isinstance(item, dict) for item in value)):
            groups += metric_rows(value, f"{group} / {name}" if group else name, str(key))
        elif value is not None and not (isinstance(value, list) and _is_left_out(value)):
            text, unit = with_unit(str(key) if _unit_of(str(key)) else f"{key}{_unit_of(unit_key)}", value)
            rows.append(Row(group, name, text, unit))
    return rows + groups


def with_unit(key: str, value: Any) -> tuple[str, str]:
    """A value as text and its unit, by the ending of its key: `_m` is shown in cm, ratios in %."""
    if isinstance(value, list):
        texts = [with_unit(key, item) for item in value]
        return ", ".join(text for text, _ in texts), texts[0][1] if texts else ""
    if isinstance(value, bool):
        return ("yes" if value else "no"), ""
    if not isinstance(value, int | float):
        return str(value), ""
    if not math.isfinite(value):
        return "not finite", ""
    if key in _RATIOS:
        return f"{value * 100:.1f}", "%"
    for suffix, factor, unit, digits in _UNITS:
        if key.endswith(suffix):
            return f"{value * factor:.{digits}f}", unit
    return (format_grouped(value) if isinstance(value, int) else f"{value:.4g}"), ""


def readable(key: str) -> str:
    """`accuracy_mean_m` -> `accuracy mean`: the unit has its own column."""
    if key in _RATIOS:
        return key.replace("f_score", "F-score").replace("_", " ")
    return key.removesuffix(_unit_of(key)).replace("_", " ")


def _unit_of(key: str) -> str:
    """The suffix of a name that denotes a unit, else nothing."""
    return next((suffix for suffix, *_ in _UNITS if key.endswith(suffix)), "")


def _named(items: Any) -> list[tuple[str, Any]]:
    """The elements of a list of records, named by their threshold, else numbered from 1."""
    if not isinstance(items, list):
        return [("value", items)]
    names = []
    for number, item in enumerate(items, start=1):
        threshold = item.get("threshold_m") if isinstance(item, dict) else None
        if isinstance(threshold, int | float) and not isinstance(threshold, bool):
            names.append(f"at {threshold * 100:g} cm")
        else:
            names.append(str(number))
    return list(zip(names, items, strict=True))


def _is_left_out(values: list[Any]) -> bool:
    return not 0 < len(values) <= _LONGEST_LIST or any(isinstance(item, list) for item in values)
