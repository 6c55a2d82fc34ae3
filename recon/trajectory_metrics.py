"""Absolute and relative trajectory errors (Sturm et al. 2012)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .errors import DataError
from .trajectory import Trajectory

MAX_DIFFERENCE_S = 0.02


@dataclass(frozen=True)
class ErrorStatistics:
    """Of non-negative errors, in the unit of the field that holds them."""

    rmse: float
    mean: float
    median: float
    max: float

    @staticmethod
    def of(errors: np.ndarray) -> ErrorStatistics:
        """errors (N,), N > 0."""
        return ErrorStatistics(
            float(np.sqrt(np.mean(errors**2))), float(errors.mean()), float(np.median(errors)), float(errors.max())
        )


@dataclass(frozen=True)
class TrajectoryMetrics:
    """ate_*   distances between true and estimated camera centres, as they are and after the best rigid motion (no
            scale) of the whole estimate
    rpe_*   errors of the motion over `rpe_delta_frames` matched poses, None if there are no more than that
    """

    ate_m: ErrorStatistics
    ate_aligned_m: ErrorStatistics
    rpe_translation_m: ErrorStatistics | None
    rpe_rotation_rad: ErrorStatistics | None
    matched_poses: int
    estimated_poses: int
    reference_poses: int
    max_difference_s: float
    rpe_delta_frames: int


def evaluate_trajectory(
    estimate: Trajectory,
    reference: Trajectory,
    *,
    max_difference_s: float = MAX_DIFFERENCE_S,
    rpe_delta_frames: int = 1,
) -> TrajectoryMetrics:
    """Score `estimate` against `reference`; poses that are not finite are left out. Raises DataError if none match."""
    pairs = associate(estimate, reference, max_difference_s)
    found, true = estimate.T_world_camera[pairs[:, 0]], reference.T_world_camera[pairs[:, 1]]
    T_true_found = rigid_alignment(found[:, :3, 3], true[:, :3, 3])
    raw = np.linalg.norm(found[:, :3, 3] - true[:, :3, 3], axis=1)
    aligned = np.linalg.norm((T_true_found @ found)[:, :3, 3] - true[:, :3, 3], axis=1)
    translation, rotation = relative_errors(found, true, rpe_delta_frames)
    return TrajectoryMetrics(
        ErrorStatistics.of(raw),
        ErrorStatistics.of(aligned),
        ErrorStatistics.of(translation) if len(translation) else None,
        ErrorStatistics.of(rotation) if len(rotation) else None,
        len(pairs),
        len(estimate),
        len(reference),
        max_difference_s,
        rpe_delta_frames,
    )


def associate(estimate: Trajectory, reference: Trajectory, max_difference_s: float) -> np.ndarray:
    """(M, 2) index pairs of poses nearest in time, each pose used once, closest pairs first. Raises DataError."""
    finite = [np.flatnonzero(np.isfinite(t.T_world_camera).all(axis=(1, 2))) for t in (estimate, reference)]
    if len(finite[0]) == 0 or len(finite[1]) == 0:
        raise DataError("one of the trajectories holds no finite pose")
    times, true_times = estimate.timestamps[finite[0]], reference.timestamps[finite[1]]
    nearest = cKDTree(true_times[:, None]).query(times[:, None])[1]
    difference = np.abs(times - true_times[nearest])
    order = np.argsort(difference, kind="stable")
    order = order[difference[order] <= max_difference_s + 1e-9]
    _, first = np.unique(nearest[order], return_index=True)
    chosen = np.sort(order[first])
    if len(chosen) == 0:
        raise DataError(
            f"the trajectories share no time stamp within {max_difference_s} s: {times[0]:.3f} to {times[-1]:.3f} and "
            f"{true_times[0]:.3f} to {true_times[-1]:.3f}; are both of the same recording?"
        )
    return np.column_stack([finite[0][chosen], finite[1][nearest[chosen]]])


def rigid_alignment(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) rigid motion that takes (N, 3) `source` to `target` with least squared error (Umeyama 1991, no scale)."""
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - target_mean).T @ (source - source_mean))
    handedness = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    T = np.eye(4)
    T[:3, :3] = u @ handedness @ vt
    T[:3, 3] = target_mean - T[:3, :3] @ source_mean
    return T


def relative_errors(found: np.ndarray, true: np.ndarray, delta: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses (N, 4, 4) -> translation errors in metres and rotation angles in radians of the motions over `delta`."""
    if len(found) <= delta:
        return np.zeros(0), np.zeros(0)
    motions = [np.linalg.inv(T[:-delta]) @ T[delta:] for T in (found, true)]
    error = np.linalg.inv(motions[1]) @ motions[0]
    skew = np.stack([error[:, 2, 1] - error[:, 1, 2], error[:, 0, 2] - error[:, 2, 0], error[:, 1, 0] - error[:, 0, 1]])
    sine, cosine = 0.5 * np.linalg.norm(skew, axis=0), 0.5 * (np.trace(error[:, :3, :3], axis1=1, axis2=2) - 1.0)
    return np.linalg.norm(error[:, :3, 3], axis=1), np.arctan2(sine, cosine)
