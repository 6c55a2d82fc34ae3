"""What a run learned about its sensors, in a few figures each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run.directory import RunDirectory
from .noise_curves import Readings
from .uncertainty_calibration import UncertaintyMetrics

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
    known = [mapped.facts.get(fact) if mapped else None for fact in ("sensor_weight_share", "sensor_reliability")]
    values = [fact.get(sensor) if isinstance(fact, dict) else None for fact in known]
    return Standing(*(float(value) if isinstance(value, int | float) else None for value in values))
