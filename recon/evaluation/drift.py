"""How the error of a trajectory grows with the length of the path and with time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.se3 import rotation_angle

SEGMENT_M = 1.0


@dataclass(frozen=True)
class Drift:
    """Growth of the position error along the true path.

    path_m                      length of the true path through the matched poses
    growth_ratio                slope of the line fitted to the unaligned position errors over the path length
    growth_m_per_s              the same over time; None without a clock
    segment_m, segments         length of a segment of the path, and number of poses at which one starts
    segment_translation_ratio   mean over the segments of translation error / path length (Geiger et al. 2012); None if
                                the path is shorter than a segment
    segment_rotation_rad_per_m  the same for the rotation
    """

    path_m: float
    growth_ratio: float | None
    growth_m_per_s: float | None
    segment_m: float
    segments: int
    segment_translation_ratio: float | None
    segment_rotation_rad_per_m: float | None


def measure_drift(
    estimate: np.ndarray, true: np.ndarray, timestamps: np.ndarray | None, segment_m: float = SEGMENT_M
) -> Drift | None:
    """Drift of the poses `estimate` against `true` (N, 4, 4), taken at `timestamps` (N,) s, None without a clock.

    None if the true camera does not move.
    """
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1))])
    if path[-1] <= 0:
        return None
    errors = np.linalg.norm(estimate[:, :3, 3] - true[:, :3, 3], axis=1)
    ends = np.searchsorted(path, path + segment_m - 1e-9)
    starts = np.flatnonzero(ends < len(path))
    ends = ends[starts]
    per_metre = None
    if len(starts):
        translation, rotation = motion_errors(estimate, true, starts, ends)
        lengths = path[ends] - path[starts]
        per_metre = float((translation / lengths).mean()), float((rotation / lengths).mean())
    return Drift(
        path_m=float(path[-1]),
        growth_ratio=_slope(path, errors),
        growth_m_per_s=None if timestamps is None else _slope(timestamps - timestamps[0], errors),
        segment_m=segment_m,
        segments=len(starts),
        segment_translation_ratio=per_metre[0] if per_metre else None,
        segment_rotation_rad_per_m=per_metre[1] if per_metre else None,
    )


def motion_errors(
    estimate: np.ndarray, true: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Errors of the motions from poses `starts` (M,) to poses `ends` (M,): metres (M,) and radians (M,).

    `estimate` and `true` are (N, 4, 4).
    """
    motions = [np.linalg.inv(T[starts]) @ T[ends] for T in (estimate, true)]
    error = np.linalg.inv(motions[1]) @ motions[0]
    return np.linalg.norm(error[:, :3, 3], axis=1), rotation_angle(error)


def _slope(x: np.ndarray, y: np.ndarray) -> float | None:
    """Slope of the least-squares line through the points; None if x is constant."""
    centred = x - x.mean()
    spread = centred @ centred
    return float(centred @ y / spread) if spread > 0 else None
