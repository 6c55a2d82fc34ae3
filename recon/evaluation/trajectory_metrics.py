"""Absolute and relative trajectory errors (Sturm et al. 2012)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from ..core.errors import DataError
from ..core.se3 import rotation_angle
from ..core.time_stamps import MAX_TIME_STAMP, explain_mismatch
from ..core.trajectory import Trajectory
from .drift import Drift, measure_drift, motion_errors


@dataclass(frozen=True)
class TrajectoryParameters:
    """How poses are matched and over what distances errors are measured.

    max_difference_s  largest difference of the time stamps of matched poses
    rpe_delta_frames  matched poses over which the relative pose error (RPE) is measured
    rpe_seconds       time over which it is measured as well
    segment_m         length of the path segments over which drift is measured
    """

    max_difference_s: float = 0.02
    rpe_delta_frames: int = 1
    rpe_seconds: float = 1.0
    segment_m: float = 1.0


DEFAULT_PARAMETERS = TrajectoryParameters()


@dataclass(frozen=True)
class ErrorStatistics:
    """Statistics of non-negative errors, in the unit of the field that holds them."""

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
class MatchedPoses:
    """Finite estimated and true poses at the same times, in order of time.

    timestamps (M,) seconds, of the estimate; estimate, true (M, 4, 4) T_world_camera; M > 0
    """

    timestamps: np.ndarray
    estimate: np.ndarray
    true: np.ndarray

    @staticmethod
    def of(
        estimate: Trajectory, reference: Trajectory, max_difference_s: float = DEFAULT_PARAMETERS.max_difference_s
    ) -> MatchedPoses:
        """Match poses by time. Raises DataError if none match."""
        pairs = associate(estimate, reference, max_difference_s)
        return MatchedPoses(
            estimate.timestamps[pairs[:, 0]],
            estimate.T_world_camera[pairs[:, 0]],
            reference.T_world_camera[pairs[:, 1]],
        )

    def __len__(self) -> int:
        return len(self.timestamps)

    @cached_property
    def T_true_estimate(self) -> np.ndarray:
        """(4, 4) rigid motion of the whole estimate that minimises the squared distances of the camera centres."""
        return rigid_alignment(self.estimate[:, :3, 3], self.true[:, :3, 3])

    def position_errors(self, *, aligned: bool) -> np.ndarray:
        """(M,) metres; `aligned`: after `T_true_estimate`."""
        estimate = self.T_true_estimate @ self.estimate if aligned else self.estimate
        return np.linalg.norm(estimate[:, :3, 3] - self.true[:, :3, 3], axis=1)

    def rotation_errors(self, *, aligned: bool) -> np.ndarray:
        """(M,) radians; `aligned`: after the one rotation that fits all orientations best.

        Unlike the rotation of `T_true_estimate`, it is determined also if the camera stands still or moves in a line.
        """
        estimate, true = self.estimate[:, :3, :3], self.true[:, :3, :3]
        common = _nearest_rotation((true @ estimate.transpose(0, 2, 1)).sum(axis=0)) if aligned else np.eye(3)
        return rotation_angle(true.transpose(0, 2, 1) @ common @ estimate)


@dataclass(frozen=True)
class TrajectoryMetrics:
    """Errors of an estimated trajectory: absolute (ATE), relative (RPE) and drift.

    ate_m          distances between true and estimated camera centres, unaligned
    ate_aligned_m  the same after the best rigid motion (no scale) of the whole estimate
    rpe_*          errors of the motion over `rpe_delta_frames` matched poses; None if there are no more than that
    rpe_second_*   the same over one second; None without a clock, or if no two poses are a second apart
    drift          how the error grows; None if the true camera does not move
    completeness   ratio of the frames of the run that have a pose; None where there is no run
    """

    ate_m: ErrorStatistics
    ate_aligned_m: ErrorStatistics
    rpe_translation_m: ErrorStatistics | None
    rpe_rotation_rad: ErrorStatistics | None
    rpe_second_translation_m: ErrorStatistics | None
    rpe_second_rotation_rad: ErrorStatistics | None
    drift: Drift | None
    matched_poses: int
    estimated_poses: int
    reference_poses: int
    max_difference_s: float
    rpe_delta_frames: int
    completeness: float | None = None


def evaluate_trajectory(
    estimate: Trajectory, reference: Trajectory, parameters: TrajectoryParameters = DEFAULT_PARAMETERS
) -> TrajectoryMetrics:
    """Score `estimate` against `reference`; poses that are not finite are left out. Raises DataError if none match."""
    matched = MatchedPoses.of(estimate, reference, parameters.max_difference_s)
    delta = parameters.rpe_delta_frames
    starts = np.arange(max(0, len(matched) - delta))
    translation, rotation = _relative_statistics(matched, starts, starts + delta)
    clock = has_clock(matched.timestamps)
    second_translation, second_rotation = None, None
    if clock:
        pairs = pairs_after(matched.timestamps, parameters.rpe_seconds)
        second_translation, second_rotation = _relative_statistics(matched, *pairs)
    return TrajectoryMetrics(
        ate_m=ErrorStatistics.of(matched.position_errors(aligned=False)),
        ate_aligned_m=ErrorStatistics.of(matched.position_errors(aligned=True)),
        rpe_translation_m=translation,
        rpe_rotation_rad=rotation,
        rpe_second_translation_m=second_translation,
        rpe_second_rotation_rad=second_rotation,
        drift=measure_drift(
            matched.estimate, matched.true, matched.timestamps if clock else None, parameters.segment_m
        ),
        matched_poses=len(matched),
        estimated_poses=len(estimate),
        reference_poses=len(reference),
        max_difference_s=parameters.max_difference_s,
        rpe_delta_frames=delta,
    )


def has_clock(timestamps: np.ndarray) -> bool:
    """Whether time stamps (N,) are seconds: if all are whole numbers, they are frame numbers (docs/conventions.md)."""
    return bool((timestamps % 1 != 0).any())


def associate(estimate: Trajectory, reference: Trajectory, max_difference_s: float) -> np.ndarray:
    """(M, 2) index pairs of poses nearest in time, each pose used once, closest pairs first. Raises DataError."""
    finite = [
        np.flatnonzero(np.isfinite(t.T_world_camera).all(axis=(1, 2)) & (np.abs(t.timestamps) < MAX_TIME_STAMP))
        for t in (estimate, reference)
    ]
    if len(finite[0]) == 0 or len(finite[1]) == 0:
        raise DataError("one of the trajectories holds no finite pose")
    times, true_times = estimate.timestamps[finite[0]], reference.timestamps[finite[1]]
    nearest = np.asarray(cKDTree(true_times[:, None]).query(times[:, None])[1])
    difference = np.abs(times - true_times[nearest])
    order = np.argsort(difference, kind="stable")
    order = order[difference[order] <= max_difference_s + 1e-9]
    _, first = np.unique(nearest[order], return_index=True)
    chosen = order[first][np.argsort(times[order[first]], kind="stable")]
    if len(chosen) == 0:
        names, rule = ("the estimate", "the reference"), "poses are not matched across"
        reason = explain_mismatch(names[0], times, names[1], true_times, max_difference_s, rule)
        raise DataError(f"the trajectories share no time stamp within {max_difference_s} s. {reason}")
    return np.column_stack([finite[0][chosen], finite[1][nearest[chosen]]])


def rigid_alignment(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) rigid motion that maps (N, 3) `source` to `target` with least squared error (Umeyama 1991, no scale)."""
    source_mean, target_mean = source.mean(axis=0), target.mean(axis=0)
    T = np.eye(4)
    T[:3, :3] = _nearest_rotation((target - target_mean).T @ (source - source_mean))
    T[:3, 3] = target_mean - T[:3, :3] @ source_mean
    return T


def pairs_after(timestamps: np.ndarray, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Indices (M,) of starts and (M,) of ends: for each of the increasing time stamps (N,) the one `seconds` later.

    A start is left out if the nearest time stamp is off by more than half the median interval, as before a gap.
    """
    if len(timestamps) < 2:
        return np.zeros(0, int), np.zeros(0, int)
    tolerance = 0.5 * float(np.median(np.diff(timestamps))) + 1e-6
    target = timestamps + seconds
    later = np.clip(np.searchsorted(timestamps, target), 1, len(timestamps) - 1)
    later -= target - timestamps[later - 1] < timestamps[later] - target
    starts = np.flatnonzero((np.abs(timestamps[later] - target) <= tolerance) & (later > np.arange(len(later))))
    return starts, later[starts]


def _relative_statistics(
    matched: MatchedPoses, starts: np.ndarray, ends: np.ndarray
) -> tuple[ErrorStatistics | None, ErrorStatistics | None]:
    if len(starts) == 0:
        return None, None
    translation, rotation = motion_errors(matched.estimate, matched.true, starts, ends)
    return ErrorStatistics.of(translation), ErrorStatistics.of(rotation)


def _nearest_rotation(matrix: np.ndarray) -> np.ndarray:
    """(3, 3) rotation with the largest inner product with `matrix` (3, 3); never a reflection."""
    u, _, vt = np.linalg.svd(matrix)
    return u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
