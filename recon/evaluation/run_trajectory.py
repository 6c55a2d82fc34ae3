"""Scores of the estimated camera of a run: trajectory errors, and consistency of the tracking record."""

from __future__ import annotations

import dataclasses

import numpy as np

from ..core.errors import DataError
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.tracking_record import TrackingRecord
from .tracking_metrics import TrackingMetrics, evaluate_tracking, rows_at
from .trajectory_metrics import TrajectoryMetrics, evaluate_trajectory
from .trajectory_pair import CameraPath


def score_trajectory(run: RunDirectory) -> TrajectoryMetrics:
    """Raises DataError if there is no trajectory, or no true pose at the same times; RunError without frames."""
    path = CameraPath.of_run(run, with_record=False)
    if path.reference is None:
        raise DataError("the data set has no ground-truth poses")
    metrics = evaluate_trajectory(path.estimate, path.reference)
    return dataclasses.replace(metrics, completeness=completeness(run, path))


def score_tracking(run: RunDirectory) -> TrackingMetrics | None:
    """None where the poses were given. Raises DataError if the record cannot be read."""
    if not run.tracking_path.is_file():
        return None
    record = TrackingRecord.load(run.tracking_path)
    try:
        matched = CameraPath.of_run(run, with_record=False).matched
    except DataError:  # no frame has a pose; the statuses still count
        matched = None
    return evaluate_tracking(record, matched)


def completeness(run: RunDirectory, path: CameraPath) -> float:
    """Ratio of the frames of the run with a finite pose; held-out frames without one are not counted."""
    times = np.array([record.timestamp for record in RunFrames(run).records])
    map_record = run.load_manifest().stages.get("map")
    held_out = (map_record.facts.get("held_out") if map_record is not None else None) or []
    posed = rows_at(path.posed.timestamps, times) >= 0
    is_held_out = np.zeros(len(times), dtype=bool)
    is_held_out[[index for index in held_out if 0 <= index < len(times)]] = True
    return int(np.count_nonzero(posed)) / max(1, int(np.count_nonzero(posed | ~is_held_out)))
