"""What a map learned about one sensor, in a few numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run.directory import RunDirectory
from .noise_curves import BetaSamples
from .uncertainty_calibration import UncertaintyMetrics


@dataclass(frozen=True)
class SensorSummaryParameters:
    """Which measurements the median betas of a sensor are made of.

    distances_m       distances at which the median beta is given
    tolerance_ratio   samples within this ratio of a distance count for it
    min_measurements  samples that a distance needs
    """

    distances_m: tuple[int, ...] = (1, 2, 3, 5)
    tolerance_ratio: float = 0.1
    min_measurements: int = 50


DEFAULT_PARAMETERS = SensorSummaryParameters()


@dataclass(frozen=True)
class SensorWeightSummary:
    """Influence of a sensor on the map; None = unknown.

    weight_share   ratio of its measurements in the fusion weights around the surface
    reliability    weight factor for its correlated errors, beside photometric depth of the same beta
    """

    weight_share: float | None = None
    reliability: float | None = None


@dataclass(frozen=True)
class SensorUncertainty:
    """Summary of one sensor; None = unknown.

    weight_share, reliability   as in `SensorWeightSummary`
    measurements                number of sampled measurements
    median_beta_m               median of their betas; `low_beta_m`, `high_beta_m`: 10th and 90th percentile
    beta_at_m                   distance in metres, as text -> median beta of the measurements at about that distance
    scores                      against the true depth
    """

    weight_share: float | None
    reliability: float | None
    measurements: int
    median_beta_m: float
    low_beta_m: float
    high_beta_m: float
    beta_at_m: dict[str, float | None]
    scores: UncertaintyMetrics | None = None


def summarise_sensor(
    samples: BetaSamples,
    weights: SensorWeightSummary = SensorWeightSummary(),
    scores: UncertaintyMetrics | None = None,
    parameters: SensorSummaryParameters = DEFAULT_PARAMETERS,
) -> SensorUncertainty:
    """The summary of one sensor."""
    low, median, high = (_rounded(value) for value in np.percentile(samples.beta, (10, 50, 90)))
    return SensorUncertainty(
        weight_share=weights.weight_share,
        reliability=weights.reliability,
        measurements=len(samples.beta),
        median_beta_m=median,
        low_beta_m=low,
        high_beta_m=high,
        beta_at_m={str(distance): _beta_at(samples, distance, parameters) for distance in parameters.distances_m},
        scores=scores,
    )


def sensor_weight_summary(run: RunDirectory, sensor: str) -> SensorWeightSummary:
    """Weight share and reliability of a sensor as the map stage recorded them."""
    return SensorWeightSummary(
        _sensor_fact(run, "sensor_weight_share", sensor), _sensor_fact(run, "sensor_reliability", sensor)
    )


def _sensor_fact(run: RunDirectory, fact: str, sensor: str) -> float | None:
    """The number that the map stage recorded for `sensor` in the dictionary `fact`; None where there is none."""
    record = run.load_manifest().stages.get("map")
    by_sensor = record.facts.get(fact) if record is not None else None
    value = by_sensor.get(sensor) if isinstance(by_sensor, dict) else None
    return float(value) if isinstance(value, int | float) else None


def _beta_at(samples: BetaSamples, distance_m: float, parameters: SensorSummaryParameters) -> float | None:
    near = np.abs(samples.depth - distance_m) < parameters.tolerance_ratio * distance_m
    return _rounded(np.median(samples.beta[near])) if near.sum() >= parameters.min_measurements else None


def _rounded(beta_m: np.floating) -> float:
    """Rounded to 0.01 mm: beta maps hold tenths of a millimetre."""
    return round(float(beta_m), 5)
