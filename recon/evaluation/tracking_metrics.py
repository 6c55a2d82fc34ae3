"""Scores of a tracking record: how many frames have which status, and whether its covariances match the errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import get_args

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from ..core.se3 import adjoint
from ..run.tracking_record import Status, TrackingRecord
from .trajectory_metrics import MatchedPoses

_SAME_TIME_S = 1e-4  # a trajectory file holds microseconds
_DIMENSIONS = 6
_LISTED_RANGES = 8


@dataclass(frozen=True)
class StatusShare:
    """Frames of one status, and their ratio of all."""

    frames: int
    ratio: float


@dataclass(frozen=True)
class Consistency:
    """Normalised estimation error squared (NEES, Bar-Shalom et al. 2001) of the predicted covariances.

    If they are right, the NEES follows a chi-square distribution with 6 degrees of freedom.

    anees         mean NEES over the 6 dimensions; 1 is right
    sigma_factor  factor on the predicted sigmas that makes the median NEES right; 1 is right
    coverage_*    ratio of the errors within the central 50 and 90 % of the predicted distribution
    """

    poses: int
    anees: float
    sigma_factor: float
    coverage_50: float
    coverage_90: float


@dataclass(frozen=True)
class TrackingMetrics:
    """Statuses of the tracked frames, and consistency of their covariances.

    since_start     consistency of the motion from the first matched pose to each later one
    between_frames  consistency of the motion between neighbouring poses, whose errors are assumed independent
    lost_ranges     first and last index of each range of lost frames

    The consistencies are None without true poses.
    """

    frames: int
    statuses: dict[str, StatusShare]
    lost_ranges: tuple[tuple[int, int], ...]
    since_start: Consistency | None
    between_frames: Consistency | None


def evaluate_tracking(record: TrackingRecord, matched: MatchedPoses | None) -> TrackingMetrics:
    """Count the statuses of `record`, and compare its covariances with the true errors of `matched`."""
    statuses = [frame.status for frame in record.frames]
    shares = {}
    for name in get_args(Status):
        count = statuses.count(name)
        shares[name] = StatusShare(count, count / max(1, len(statuses)))
    since_start = between = None
    if matched is not None and len(matched) > 1:
        covariances = pose_covariances(record, matched.timestamps)
        ends = np.arange(1, len(matched))
        since_start = _consistency(matched, covariances, np.zeros_like(ends), ends)
        between = _consistency(matched, covariances, ends - 1, ends)
    return TrackingMetrics(len(statuses), shares, tuple(record.lost_ranges()), since_start, between)


def describe_lost(metrics: TrackingMetrics) -> str:
    """One sentence: how many frames were lost, and which."""
    lost = metrics.statuses["lost"].frames
    if not lost:
        return f"No frame of {metrics.frames} was lost."
    ranges = [str(a) if a == b else f"{a} to {b}" for a, b in metrics.lost_ranges]
    more = f" and {len(ranges) - _LISTED_RANGES} more ranges" if len(ranges) > _LISTED_RANGES else ""
    return f"{lost} of {metrics.frames} frames were lost: {', '.join(ranges[:_LISTED_RANGES])}{more}."


def pose_covariances(record: TrackingRecord, timestamps: np.ndarray) -> np.ndarray:
    """(N, 6, 6) covariances in `record` of the poses at `timestamps` (N,); NaN where there is none of that shape."""
    covariances = np.full((len(timestamps), _DIMENSIONS, _DIMENSIONS), np.nan)
    for row, frame in enumerate(record_rows(record, timestamps)):
        covariance = record.frames[frame].covariance if frame >= 0 else None
        if covariance is not None and [len(line) for line in covariance] == [_DIMENSIONS] * _DIMENSIONS:
            covariances[row] = covariance
    return covariances


def record_rows(record: TrackingRecord, timestamps: np.ndarray) -> np.ndarray:
    """(N,) positions in `record.frames` of the frames taken at `timestamps` (N,); -1 where there is none."""
    return rows_at(np.array([frame.timestamp for frame in record.frames]), timestamps)


def rows_at(times: np.ndarray, targets: np.ndarray) -> np.ndarray:
    """(N,) indices in `times` (M,) of the time stamps `targets` (N,), within the precision of files; -1 if missing."""
    if len(times) == 0:
        return np.full(len(targets), -1)
    order = np.argsort(times, kind="stable")
    rows = order[np.clip(np.searchsorted(times[order], targets - _SAME_TIME_S), 0, len(times) - 1)]
    return np.where(np.abs(times[rows] - targets) <= _SAME_TIME_S, rows, -1)


def predicted_sigmas(covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 6, 6) -> predicted RMS of the position error, metres, and of the rotation error, radians; (N,) each."""
    variances = np.diagonal(covariances, axis1=1, axis2=2)
    sums = variances[:, :3].sum(axis=1), variances[:, 3:].sum(axis=1)
    position, rotation = (np.sqrt(np.where(total >= 0, total, np.nan)) for total in sums)
    return position, rotation


def normalised_errors(
    estimate: np.ndarray, true: np.ndarray, covariances: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> np.ndarray:
    """(M,) NEES of each motion from `starts` to `ends` (M,); NaN where its covariance is not positive definite.

    With poses T exp(x), the motion M = T_start^-1 T_end has the error x_end - Ad(M^-1) x_start to first order.
    """
    motions = [np.linalg.inv(poses[starts]) @ poses[ends] for poses in (true, estimate)]
    error = np.linalg.inv(motions[0]) @ motions[1]
    x = np.concatenate([error[:, :3, 3], Rotation.from_matrix(error[:, :3, :3]).as_rotvec()], axis=1)
    to_end = adjoint(np.linalg.inv(motions[0]))
    covariance = covariances[ends] + to_end @ covariances[starts] @ to_end.transpose(0, 2, 1)
    covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
    usable = np.isfinite(covariance).all(axis=(1, 2))
    values, vectors = np.linalg.eigh(np.where(usable[:, None, None], covariance, np.eye(_DIMENSIONS)))
    usable &= values[:, 0] > 1e-14 * values[:, -1]
    projections = np.einsum("mij,mi->mj", vectors, x)
    result = np.full(len(x), np.nan)
    result[usable] = (projections[usable] ** 2 / values[usable]).sum(axis=1)
    return result


def _consistency(
    matched: MatchedPoses, covariances: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> Consistency | None:
    errors = normalised_errors(matched.estimate, matched.true, covariances, starts, ends)
    errors = errors[np.isfinite(errors)]
    if len(errors) == 0:
        return None
    coverage_50, coverage_90 = (float(np.mean(errors <= chi2.ppf(level, _DIMENSIONS))) for level in (0.5, 0.9))
    factor = float(np.sqrt(np.median(errors) / chi2.ppf(0.5, _DIMENSIONS)))
    return Consistency(len(errors), float(errors.mean() / _DIMENSIONS), factor, coverage_50, coverage_90)
