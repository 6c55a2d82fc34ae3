"""The scores of an uncertainty as rows of text for people: (metric, value, unit)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from ..core.number_format import UNKNOWN, format_cm, format_number, format_percent

if TYPE_CHECKING:
    from ..evaluation.sensor_summary import SensorUncertainty
    from ..evaluation.uncertainty_calibration import UncertaintyMetrics
    from ..evaluation.vertex_sigma_metrics import VertexSigmaMetrics

Rows = list[tuple[str, str, str]]


def uncertainty_rows(metrics: UncertaintyMetrics) -> Rows:
    """Scores of the beta of a sensor, in nats, % and cm; scores that are unknown are left out."""
    lengths = f"{format_cm(metrics.mean_error_m)} / {format_cm(metrics.mean_beta_m)}"
    rows = [
        ("negative log-likelihood (NLL)", format_number(metrics.nll_nats), "nats"),
        ("NLL of the best constant beta", format_number(metrics.nll_constant_nats), "nats"),
        ("NLL of the best beta of depth alone", format_number(metrics.nll_depth_nats), "nats"),
        ("coverage of the 50 % interval", format_percent(metrics.coverage_50), "%"),
        ("coverage of the 90 % interval", format_percent(metrics.coverage_90), "%"),
        ("coverage of the calibrated 50 % interval", format_percent(metrics.calibrated_coverage_50), "%"),
        ("coverage of the calibrated 90 % interval", format_percent(metrics.calibrated_coverage_90), "%"),
        ("AUSE (random order)", f"{metrics.ause:.3f} ({metrics.ause_random:.3f})", ""),
        ("AUSE of the best beta of depth alone", format_number(metrics.ause_depth), ""),
        ("closer to the oracle than depth alone", format_percent(metrics.ause_gain), "%"),
        ("rank correlation with the error", format_number(metrics.rank_correlation), ""),
        ("mean error / mean beta", lengths, "cm"),
    ]
    return [row for row in rows if row[1] != UNKNOWN or row[0].startswith("rank")]


def vertex_sigma_rows(metrics: VertexSigmaMetrics) -> Rows:
    """Scores of the sigma of vertices, in %, cm and sigmas."""
    lengths = f"{format_cm(metrics.median_distance_m)} / {format_cm(metrics.median_sigma_m)}"
    return [
        ("vertices within 1 sigma (ideal: 68.3)", format_percent(metrics.coverage_1_sigma), "%"),
        ("vertices within 2 sigma (ideal: 95.4)", format_percent(metrics.coverage_2_sigma), "%"),
        ("median distance / sigma (ideal: 0.674)", format_number(metrics.median_in_sigmas), ""),
        ("rank correlation of sigma and distance", format_number(metrics.rank_correlation), ""),
        ("AUSE of sigma (random order)", f"{metrics.ause:.3f} ({metrics.ause_random:.3f})", ""),
        ("median distance / median sigma", lengths, "cm"),
    ]


def summary_table(sensors: Mapping[str, SensorUncertainty]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of text: a column for each sensor, in % and cm; "-" where a value is unknown."""
    columns = {sensor: _summary_column(summary) for sensor, summary in sensors.items()}
    metrics = dict.fromkeys(metric for column in columns.values() for metric in column)
    rows = [[name, *(column.get((name, unit), UNKNOWN) for column in columns.values()), unit] for name, unit in metrics]
    return ["Metric", *columns, "Unit"], rows


def _summary_column(sensor: SensorUncertainty) -> dict[tuple[str, str], str]:
    """(metric, unit) -> value of one sensor."""
    rows: Rows = [("weight share", format_percent(sensor.weight_share, 1), "%")]
    if sensor.reliability is not None:
        rows.append(("sensor reliability", format_number(sensor.reliability, 2), ""))
    rows += [
        ("beta, median", format_cm(sensor.median_beta_m), "cm"),
        ("beta, 10th to 90th percentile", f"{format_cm(sensor.low_beta_m)} to {format_cm(sensor.high_beta_m)}", "cm"),
        *((f"beta at {distance} m", format_cm(beta), "cm") for distance, beta in sensor.beta_at_m.items()),
    ]
    if sensor.scores is not None:
        rows += uncertainty_rows(sensor.scores)
    return {(name, unit): value for name, value, unit in rows}
