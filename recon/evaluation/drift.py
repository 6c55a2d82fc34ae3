"""How the error of a trajectory grows with the way and the time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SEGMENT_M = 1.0


@dataclass(frozen=True)
class Drift:
    """path_m                      length of the true path through the matched poses
    growth_ratio                slope of the line through the unaligned position errors over the way travelled
    growth_m_per_s              the same over time; None without a clock
    segments                    starts from which the true path goes on for `segment_m` or more
    segment_translation_ratio   mean over the segments: translation error of the motion over the length of the way
                                (Geiger et al. 2012); None if the path is shorter than a segment, as the next
    segment_rotation_rad_per_m  the same of the rotation
    """

    path_m: float
    growth_ratio: float | None
    growth_m_per_s: float | None
    segment_m: float
    segments: int
    segment_translation_ratio: float | None
    segment_rotation_rad_per_m: float | None


def measure_drift(
    found: np.ndarray, true: np.ndarray, timestamps: np.ndarray | None, segment_m: float = SEGMENT_M
) -> Drift | None:
    """Drift of `found` against `true` (N, 4, 4), at times (N,) s where there is a clock; None if nothing moves."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1))])
    if way[-1] <= 0:
        return None
    errors = np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1)
    ends = np.searchsorted(way, way + segment_m - 1e-9)
    starts = np.flatnonzero(ends < len(way))
    ends = ends[starts]
    per_metre = None
    if len(starts):
        translation, rotation = motion_errors(found, true, starts, ends)
        lengths = way[ends] - way[starts]
        per_metre = float((translation / lengths).mean()), float((rotation / lengths).mean())
    return Drift(
        path_m=float(way[-1]),
        growth_ratio=_slope(way, errors),
        growth_m_per_s=None if timestamps is None else _slope(timestamps - timestamps[0], errors),
        segment_m=segment_m,
        segments=len(starts),
        segment_translation_ratio=per_metre[0] if per_metre else None,
        segment_rotation_rad_per_m=per_metre[1] if per_metre else None,
    )


def motion_errors(
    found: np.ndarray, true: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Translation errors in metres and rotation errors in radians, (M,) each, of motions between poses (N, 4, 4)."""
    motions = [np.linalg.inv(T[starts]) @ T[ends] for T in (found, true)]
    error = np.linalg.inv(motions[1]) @ motions[0]
    return np.linalg.norm(error[:, :3, 3], axis=1), rotation_angles(error[:, :3, :3])


def rotation_angles(rotations: np.ndarray) -> np.ndarray:
    """(N, 3, 3) -> (N,) radians from 0 to pi; exact for small angles, too."""
    differences = rotations - rotations.transpose(0, 2, 1)
    sine = 0.5 * np.linalg.norm(differences[:, [2, 0, 1], [1, 2, 0]], axis=1)
    return np.arctan2(sine, 0.5 * (np.trace(rotations, axis1=1, axis2=2) - 1.0))


def _slope(x: np.ndarray, y: np.ndarray) -> float | None:
    """Of the line with least squared error through the points; None if x is constant."""
    centred = x - x.mean()
    spread = centred @ centred
    return float(centred @ y / spread) if spread > 0 else None
