"""The scores of an uncertainty as rows of text for people: (figure, value, unit)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ..evaluation.sensor_summary import SensorUncertainty

if TYPE_CHECKING:
    from ..evaluation.uncertainty_calibration import UncertaintyMetrics
    from ..evaluation.vertex_sigma_metrics import VertexSigmaMetrics

Rows = list[tuple[str, str, str]]


def uncertainty_rows(metrics: UncertaintyMetrics) -> Rows:
    """Of the beta of a sensor; in nats, % and cm."""
    lengths = f"{_cm(metrics.mean_error_m)} / {_cm(metrics.mean_beta_m)}"
    rows = [
        ("negative log-likelihood", f"{metrics.nll_nats:.3f}", "nats"),
        ("the same, best constant beta", f"{metrics.nll_constant_nats:.3f}", "nats"),
        ("the same, best beta of depth alone", _number(metrics.nll_depth_nats), "nats"),
        ("coverage of the 50 % interval", _percent(metrics.coverage_50), "%"),
        ("coverage of the 90 % interval", _percent(metrics.coverage_90), "%"),
        ("coverage of the stated 50 % interval", _percent(metrics.stated_coverage_50), "%"),
        ("coverage of the stated 90 % interval", _percent(metrics.stated_coverage_90), "%"),
        ("AUSE (random order)", f"{metrics.ause:.3f} ({metrics.ause_random:.3f})", ""),
        ("AUSE of the best beta of depth alone", _number(metrics.ause_depth), ""),
        ("closer to the oracle than depth alone", _percent(metrics.ause_gain), "%"),
        ("rank correlation with the error", _number(metrics.rank_correlation), ""),
        ("mean error / mean beta", lengths, "cm"),
    ]
    return [row for row in rows if row[1] != "-" or row[0].startswith("rank")]


def vertex_sigma_rows(metrics: VertexSigmaMetrics) -> Rows:
    """Of the sigma of vertices; in %, cm and sigmas."""
    lengths = f"{_cm(metrics.median_distance_m)} / {_cm(metrics.median_sigma_m)}"
    return [
        ("vertices within 1 sigma (right: 68.3)", _percent(metrics.coverage_1_sigma), "%"),
        ("vertices within 2 sigma (right: 95.4)", _percent(metrics.coverage_2_sigma), "%"),
        ("median distance over sigma (right: 0.674)", _number(metrics.median_in_sigmas), ""),
        ("rank correlation of sigma and distance", _number(metrics.rank_correlation), ""),
        ("AUSE of sigma (random order)", f"{metrics.ause:.3f} ({metrics.ause_random:.3f})", ""),
        ("median distance / median sigma", lengths, "cm"),
    ]


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3f}"


def _percent(ratio: float | None) -> str:
    return "-" if ratio is None else f"{ratio * 100:.2f}"


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
