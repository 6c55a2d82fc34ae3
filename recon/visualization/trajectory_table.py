"""The scores of a camera as rows of text for people: (figure, value, unit)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..evaluation.tracking_metrics import Consistency, TrackingMetrics
    from ..evaluation.trajectory_metrics import ErrorStatistics, TrajectoryMetrics

Rows = list[tuple[str, str, str]]


def trajectory_rows(metrics: TrajectoryMetrics) -> Rows:
    """Rows in cm, degrees and %; RMSE / mean / median / max."""
    over = f"over {metrics.rpe_delta_frames} frame"
    degrees = math.degrees(1.0)
    rows = [
        ("ATE as it is, RMSE / mean / median / max", _statistics(metrics.ate_m, 100), "cm"),
        ("ATE aligned, RMSE / mean / median / max", _statistics(metrics.ate_aligned_m, 100), "cm"),
        (f"RPE translation {over}", _statistics(metrics.rpe_translation_m, 100), "cm"),
        (f"RPE rotation {over}", _statistics(metrics.rpe_rotation_rad, degrees), "deg"),
    ]
    if metrics.rpe_second_translation_m is not None:
        rows += [
            ("RPE translation over 1 s", _statistics(metrics.rpe_second_translation_m, 100), "cm"),
            ("RPE rotation over 1 s", _statistics(metrics.rpe_second_rotation_rad, degrees), "deg"),
        ]
    if metrics.drift is not None:
        drift = metrics.drift
        segment = f"drift over {drift.segment_m:g} m of way"
        rows += [
            (f"{segment}, translation", _number(drift.segment_translation_ratio, 100), "%"),
            (f"{segment}, rotation", _number(drift.segment_rotation_rad_per_m, degrees), "deg/m"),
            ("growth of the error with the way", _number(drift.growth_ratio, 100), "%"),
            ("growth of the error with time", _number(drift.growth_m_per_s, 100, 3), "cm/s"),
            ("length of the way", f"{drift.path_m:.2f}", "m"),
        ]
    if metrics.completeness is not None:
        rows.append(("frames of the run with a pose", _number(metrics.completeness, 100), "%"))
    return [*rows, ("poses matched, of", f"{metrics.matched_poses} / {metrics.estimated_poses}", "")]


def tracking_rows(metrics: TrackingMetrics) -> Rows:
    """Rows in frames and %, and of the covariances, for which 1, 50 % and 90 % are right."""
    rows = [
        (f"frames {status}", f"{share.frames} ({share.ratio * 100:.1f} %)", "")
        for status, share in metrics.statuses.items()
    ]
    for name, consistency in (("since the start", metrics.since_start), ("between frames", metrics.between_frames)):
        if consistency is not None:
            rows += _consistency_rows(name, consistency)
    return rows


def _consistency_rows(name: str, consistency: Consistency) -> Rows:
    covered = f"{consistency.coverage_50 * 100:.1f} / {consistency.coverage_90 * 100:.1f}"
    return [
        (f"true over stated sigma, {name}", f"{consistency.sigma_factor:.2f}", ""),
        (f"coverage of the 50 / 90 % region, {name}", covered, "%"),
        (f"normalised squared error, {name}", f"{consistency.anees:.2f}", ""),
    ]


def _statistics(errors: ErrorStatistics | None, factor: float) -> str:
    if errors is None:
        return "-"
    return " / ".join(f"{value * factor:.2f}" for value in (errors.rmse, errors.mean, errors.median, errors.max))


def _number(value: float | None, factor: float, digits: int = 2) -> str:
    return "-" if value is None else f"{value * factor:.{digits}f}"
