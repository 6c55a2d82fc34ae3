"""What a tracker says of itself: how many frames it holds, and whether its covariances are honest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ..run.tracking_record import Status, TrackingRecord
from .trajectory_metrics import MatchedPoses

_SAME_TIME_S = 1e-4  # a trajectory file holds microseconds
_DIMENSIONS = 6
_LISTED = 8


@dataclass(frozen=True)
class StatusShare:
    """Frames of one status, and their share of all."""

    frames: int
    ratio: float


@dataclass(frozen=True)
class Consistency:
    """Squared errors in units of their covariance (NEES, Bar-Shalom et al. 2001), chi-square of 6 where it is honest.

    anees         mean over the 6 dimensions; 1 is right
    sigma_factor  what the stated sigmas have to be multiplied by to make the median right; 1 is right
    coverage_*    share of the errors within the central 50 and 90 % of what is stated
    """

    poses: int
    anees: float
    sigma_factor: float
    coverage_50: float
    coverage_90: float


@dataclass(frozen=True)
class TrackingMetrics:
    """since_start     errors of the motion from the first matched pose to each later one
    between_frames  errors of the motion between neighbouring poses, taken as independent; None without a truth
    lost_ranges     first and last index of each stretch of lost frames
    """

    frames: int
    statuses: dict[str, StatusShare]
    lost_ranges: tuple[tuple[int, int], ...]
    since_start: Consistency | None
    between_frames: Consistency | None


def evaluate_tracking(record: TrackingRecord, matched: MatchedPoses | None) -> TrackingMetrics:
    """Count the statuses of `record`, and hold its covariances against the true errors where `matched` has them."""
    said = [frame.status for frame in record.frames]
    shares = {name: StatusShare(said.count(name), said.count(name) / max(1, len(said))) for name in get_args(Status)}
    since_start = between = None
    if matched is not None and len(matched) > 1:
        covariances = pose_covariances(record, matched.timestamps)
        ends = np.arange(1, len(matched))
        since_start = _consistency(matched, covariances, np.zeros_like(ends), ends)
        between = _consistency(matched, covariances, ends - 1, ends)
    return TrackingMetrics(len(said), shares, tuple(record.lost_ranges()), since_start, between)


def describe_lost(metrics: TrackingMetrics) -> str:
    """One line: how many frames were lost, and where."""
    lost = metrics.statuses["lost"].frames
    if not lost:
        return f"No frame of {metrics.frames} was lost."
    stretches = [str(a) if a == b else f"{a} to {b}" for a, b in metrics.lost_ranges]
    more = f" and {len(stretches) - _LISTED} more stretches" if len(stretches) > _LISTED else ""
    return f"{lost} of {metrics.frames} frames were lost: {', '.join(stretches[:_LISTED])}{more}."


def pose_covariances(record: TrackingRecord, timestamps: np.ndarray) -> np.ndarray:
    """(N, 6, 6) what `record` states for the poses at `timestamps` (N,); NaN where it states nothing usable."""
    covariances = np.full((len(timestamps), _DIMENSIONS, _DIMENSIONS), np.nan)
    for row, frame in enumerate(record_rows(record, timestamps)):
        stated = record.frames[frame].covariance if frame >= 0 else None
        if stated is not None and [len(line) for line in stated] == [_DIMENSIONS] * _DIMENSIONS:
            covariances[row] = stated
    return covariances


def record_rows(record: TrackingRecord, timestamps: np.ndarray) -> np.ndarray:
    """(N,) positions in `record.frames` of the frames taken at `timestamps` (N,); -1 where there is none."""
    return rows_at(np.array([frame.timestamp for frame in record.frames]), timestamps)


def rows_at(times: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """(N,) indices in `times` (M,) of the time stamps `wanted` (N,), as exactly as files hold them; -1 if missing."""
    if len(times) == 0:
        return np.full(len(wanted), -1)
    order = np.argsort(times, kind="stable")
    rows = order[np.clip(np.searchsorted(times[order], wanted - _SAME_TIME_S), 0, len(times) - 1)]
    return np.where(np.abs(times[rows] - wanted) <= _SAME_TIME_S, rows, -1)


def stated_sigmas(covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 6, 6) -> root mean square of the position error, metres, and of the rotation error, radians; (N,) each."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    sums = variances[:, :3].sum(axis=1), variances[:, 3:].sum(axis=1)
    position, rotation = (np.sqrt(np.where(total >= 0, total, np.nan)) for total in sums)
    return position, rotation


def normalised_errors(
    found: np.ndarray, true: np.ndarray, covariances: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """(M,) squared error of each motion over its covariance; NaN where that is not positive definite.

    With poses T exp(x), the motion M = T_start^-1 T_end has the error x_end - Ad(M^-1) x_start to first order.
    """
    motions = [np.linalg.inv(poses[starts]) @ poses[ends] for poses in (true, found)]
    error = np.linalg.inv(motions[0]) @ motions[1]
    x = np.concatenate([error[:, :3, 3], Rotation.from_matrix(error[:, :3, :3]).as_rotvec()], axis=1)
    back = _adjoint(np.linalg.inv(motions[0]))
    covariance = covariances[ends] + back @ covariances[starts] @ back.transpose(0, 2, 1)
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    usable = np.isfinite(covariance).all(axis=(1, 2))
    values, vectors = np.linalg.eigh(np.where(usable[:, None, None], covariance, np.eye(_DIMENSIONS)))
    usable &= values[:, 0] > 1e-14 * values[:, -1]
    along = np.einsum("mij,mi->mj", vectors, x)
    result = np.full(len(x), np.nan)
    result[usable] = (along[usable] ** 2 / values[usable]).sum(axis=1)
    return result


def _consistency(
    matched: MatchedPoses, covariances: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> Consistency | None:
    errors = normalised_errors(matched.found, matched.true, covariances, starts, ends)
    errors = errors[np.isfinite(errors)]
    if len(errors) == 0:
        return None
    within = [float(np.mean(errors <= chi2.ppf(share, _DIMENSIONS))) for share in (0.5, 0.9)]
    factor = float(np.sqrt(np.median(errors) / chi2.ppf(0.5, _DIMENSIONS)))
    return Consistency(len(errors), float(errors.mean() / _DIMENSIONS), factor, *within)


def _adjoint(T: np.ndarray) -> np.ndarray:
    """(N, 4, 4) -> (N, 6, 6) with T exp(x) = exp(Ad x) T, translation first."""
    rotation, (x, y, z) = T[:, :3, :3], T[:, :3, 3].T
    zero = np.zeros_like(x)
    cross = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
    result = np.zeros((len(T), _DIMENSIONS, _DIMENSIONS))
    result[:, :3, :3] = result[:, 3:, 3:] = rotation
    result[:, :3, 3:] = cross @ rotation
    return result
