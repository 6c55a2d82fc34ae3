"""The scores of the camera of a run: its errors where there is a truth, and what the tracker said of it."""

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
    """Raises DataError if there is no trajectory, or no truth at the same times; RunError without frames."""
    path = CameraPath.of_run(run, with_record=False)
    if path.reference is None:
        raise DataError("the data set has no ground-truth poses")
    metrics = evaluate_trajectory(path.estimate, path.reference)
    return dataclasses.replace(metrics, completeness=completeness(run, path))


def score_tracking(run: RunDirectory) -> TrackingMetrics | None:
    """None where nothing was tracked. Raises DataError if the record cannot be read."""
    if not run.tracking_path.is_file():
        return None
    record = TrackingRecord.load(run.tracking_path)
    try:
        matched = CameraPath.of_run(run, with_record=False).matched
    except DataError:  # no frame has a pose; the statuses say so
        matched = None
    return evaluate_tracking(record, matched)


def completeness(run: RunDirectory, path: CameraPath) -> float:
    """Share of the frames of the run with a finite pose; those held out of the map count only if they have one."""
    frames = np.array([record.timestamp for record in RunFrames(run).records])
    mapped = run.manifest.stages.get("map")
    held_out = (mapped.facts.get("held_out") if mapped is not None else None) or []
    posed = rows_at(path.posed.timestamps, frames) >= 0
    left_out = np.zeros(len(frames), dtype=bool)
    left_out[[index for index in held_out if 0 <= index < len(frames)]] = True
    return float(np.count_nonzero(posed) / max(1, np.count_nonzero(posed | ~left_out)))
