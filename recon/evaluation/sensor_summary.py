"""What a run learned about its sensors, in a few figures each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from .uncertainty_calibration import UncertaintyMetrics
from .noise_curves import Readings
from ..run.directory import RunDirectory
from ..visualization.uncertainty_table import uncertainty_rows

DISTANCES_M = (1, 2, 3, 5)
WITHIN = 0.1  # readings this share nearer or farther count for a distance
FEWEST = 50  # readings that a distance needs


@dataclass(frozen=True)
class Standing:
    """What a sensor counts in the map; None = unknown.

    map_share        share of its readings in the weights that decide where the surface of the map is
    reading_worth    what one of them counts beside one of colour with the same beta
    """

    map_share: float | None = None
    reading_worth: float | None = None


@dataclass(frozen=True)
class SensorUncertainty:
    """Of one sensor; None = unknown.

    map_share, reading_worth    as in `Standing`
    median_beta_m    of the readings that were looked at; `low_beta_m` and `high_beta_m`: their 10th and 90th percentile
    beta_at_m        distance in metres, as text -> median beta of the readings about there
    scores           against the true depth
    """

    map_share: float | None
    reading_worth: float | None
    readings: int
    median_beta_m: float
    low_beta_m: float
    high_beta_m: float
    beta_at_m: dict[str, float | None]
    scores: UncertaintyMetrics | None = None


def summarise(
    readings: Readings, standing: Standing = Standing(), scores: UncertaintyMetrics | None = None
) -> SensorUncertainty:
    """The figures of one sensor."""
    low, median, high = (_rounded(value) for value in np.percentile(readings.beta, (10, 50, 90)))
    at = {str(distance): _beta_at(readings, distance) for distance in DISTANCES_M}
    counts = standing.map_share, standing.reading_worth
    return SensorUncertainty(*counts, len(readings.beta), median, low, high, at, scores)


def _beta_at(readings: Readings, distance_m: float) -> float | None:
    near = np.abs(readings.depth - distance_m) < WITHIN * distance_m
    return _rounded(np.median(readings.beta[near])) if near.sum() >= FEWEST else None


def _rounded(beta_m: np.floating) -> float:
    """Beta maps hold tenths of a millimetre."""
    return round(float(beta_m), 5)


def standing_of(run: RunDirectory, sensor: str) -> Standing:
    """What the sensor counts as the map stage recorded it."""
    mapped = run.manifest.stages.get("map")
    known = [mapped.facts.get(fact) if mapped else None for fact in ("sensor_share", "reading_worth")]
    values = [fact.get(sensor) if isinstance(fact, dict) else None for fact in known]
    return Standing(*(float(value) if isinstance(value, int | float) else None for value in values))


def summary_table(sensors: Mapping[str, SensorUncertainty]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of text for people: a column for each sensor, in % and cm; "-" where a sensor has no figure."""
    columns = {sensor: {(name, unit): value for name, value, unit in _figures(s)} for sensor, s in sensors.items()}
    figures = dict.fromkeys(figure for column in columns.values() for figure in column)
    rows = [[name, *(column.get((name, unit), "-") for column in columns.values()), unit] for name, unit in figures]
    return ["Figure", *columns, "Unit"], rows


def _figures(sensor: SensorUncertainty) -> list[tuple[str, str, str]]:
    share = "-" if sensor.map_share is None else f"{sensor.map_share * 100:.1f}"
    rows = [
        ("share in the map", share, "%"),
        *([] if sensor.reading_worth is None else [("worth of a reading", f"{sensor.reading_worth:.2f}", "")]),
        ("beta, median", _cm(sensor.median_beta_m), "cm"),
        ("beta of the middle 80 % of readings", f"{_cm(sensor.low_beta_m)} to {_cm(sensor.high_beta_m)}", "cm"),
        *((f"beta at {distance} m", _cm(beta), "cm") for distance, beta in sensor.beta_at_m.items()),
    ]
    return rows + (uncertainty_rows(sensor.scores) if sensor.scores is not None else [])


def _cm(metres: float | None) -> str:
    return "-" if metres is None else f"{metres * 100:.2f}"
