"""The scores of a camera trajectory as rows of text for people: (metric, value, unit)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from ..core.number_format import UNKNOWN, format_number, format_percent

if TYPE_CHECKING:
    from ..evaluation.drift import Drift
    from ..evaluation.tracking_metrics import Consistency, TrackingMetrics
    from ..evaluation.trajectory_metrics import ErrorStatistics, TrajectoryMetrics

Rows = list[tuple[str, str, str]]
_DEGREES = math.degrees(1.0)


def trajectory_rows(metrics: TrajectoryMetrics) -> Rows:
    """Rows in cm, degrees and %; RMSE / mean / median / max."""
    over = f"over {metrics.rpe_delta_frames} frame"
    rows = [
        ("ATE (unaligned), RMSE / mean / median / max", _statistics(metrics.ate_m, 100), "cm"),
        ("ATE (aligned), RMSE / mean / median / max", _statistics(metrics.ate_aligned_m, 100), "cm"),
        (f"RPE translation {over}", _statistics(metrics.rpe_translation_m, 100), "cm"),
        (f"RPE rotation {over}", _statistics(metrics.rpe_rotation_rad, _DEGREES), "deg"),
    ]
    if metrics.rpe_second_translation_m is not None:
        rows += [
            ("RPE translation over 1 s", _statistics(metrics.rpe_second_translation_m, 100), "cm"),
            ("RPE rotation over 1 s", _statistics(metrics.rpe_second_rotation_rad, _DEGREES), "deg"),
        ]
    if metrics.drift is not None:
        rows += _drift_rows(metrics.drift)
    if metrics.completeness is not None:
        rows.append(("frames of the run with a pose", format_percent(metrics.completeness), "%"))
    return [*rows, ("matched / estimated poses", f"{metrics.matched_poses} / {metrics.estimated_poses}", "")]


def _drift_rows(drift: Drift) -> Rows:
    segment = f"drift over {drift.segment_m:g} m of path"
    return [
        (f"{segment}, translation", format_percent(drift.segment_translation_ratio), "%"),
        (f"{segment}, rotation", format_number(drift.segment_rotation_rad_per_m, 2, _DEGREES), "deg/m"),
        ("error growth over the path", format_percent(drift.growth_ratio), "%"),
        ("error growth over time", format_number(drift.growth_m_per_s, 3, 100.0), "cm/s"),
        ("path length", format_number(drift.path_m, 2), "m"),
    ]


def tracking_rows(metrics: TrackingMetrics) -> Rows:
    """Frames by status in %, and the consistency of the covariances, for which 1, 50 % and 90 % are ideal."""
    rows = [
        (f"frames {status}", f"{share.frames} ({format_percent(share.ratio, 1)} %)", "")
        for status, share in metrics.statuses.items()
    ]
    for name, consistency in (("since the start", metrics.since_start), ("between frames", metrics.between_frames)):
        if consistency is not None:
            rows += _consistency_rows(name, consistency)
    return rows


def _consistency_rows(name: str, consistency: Consistency) -> Rows:
    coverage = f"{format_percent(consistency.coverage_50, 1)} / {format_percent(consistency.coverage_90, 1)}"
    return [
        (f"true / predicted sigma, {name}", format_number(consistency.sigma_factor, 2), ""),
        (f"coverage of the 50 / 90 % region, {name}", coverage, "%"),
        (f"normalised squared error (ANEES), {name}", format_number(consistency.anees, 2), ""),
    ]


def _statistics(errors: ErrorStatistics | None, factor: float) -> str:
    """RMSE / mean / median / max."""
    if errors is None:
        return UNKNOWN
    return " / ".join(
        format_number(value, 2, factor) for value in (errors.rmse, errors.mean, errors.median, errors.max)
    )
