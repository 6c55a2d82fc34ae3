"""Two files of poses, brought to common time stamps or frame numbers so that they can be compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..core.errors import DataError
from ..core.events import OnEvent, Warn, ignore
from ..core.pose_tables import PoseTable, read_pose_table
from ..core.trajectory import Trajectory
from .trajectory_metrics import has_clock


def load_trajectories(
    estimate_path: Path, reference_path: Path, on_event: OnEvent = ignore
) -> tuple[Trajectory, Trajectory]:
    """Estimated and true poses of two files in any format of `recon/core/pose_tables.py`.

    Both have time stamps, or both have frame numbers: poses without either count from 0 in the order of the file.
    Where one file has a clock and the other has not, poses belong together in order if there are as many in both.
    What is assumed is reported. Raises DataError if a file cannot be read, or it cannot be told which poses belong
    together.
    """
    tables = read_pose_table(estimate_path), read_pose_table(reference_path)
    for note in (note for table in tables for note in table.notes):
        on_event(Warn(note))
    timed, counted = tables if tables[0].times is not None else tables[::-1]
    if timed.times is None or counted.times is not None:
        labels = [_labels(table) for table in tables]
        _warn_of_counts(tables, on_event)
    elif has_clock(timed.times[np.isfinite(timed.times)]):
        _require_same_count(timed, counted, on_event)
        labels = [timed.times, timed.times]
    else:  # whole numbers in the place of time stamps count frames
        labels = [_labels(table) for table in tables]
    first, second = (Trajectory(label, table.T_world_camera) for label, table in zip(labels, tables, strict=True))
    return first, second


def _labels(table: PoseTable) -> np.ndarray:
    """(N,) seconds or frame numbers."""
    if table.times is not None:
        return table.times
    return np.arange(len(table), dtype=float) if table.numbers is None else table.numbers


def _warn_of_counts(tables: tuple[PoseTable, PoseTable], on_event: OnEvent) -> None:
    """Poses that count from 0 can be of other frames, if the files have different numbers of them."""
    counted = [table for table in tables if table.times is None and table.numbers is None]
    sizes = [len(table) for table in tables]
    if counted and sizes[0] != sizes[1]:
        what = f"though there are {sizes[0]} estimated and {sizes[1]} true poses"
        on_event(Warn(f"{counted[0].path} has no time stamps or frame numbers: its poses count from 0, {what}"))


def _require_same_count(timed: PoseTable, counted: PoseTable, on_event: OnEvent) -> None:
    if len(timed) != len(counted):
        raise DataError(
            f"{timed.path} has {len(timed)} poses with time stamps and {counted.path} {len(counted)} without: it "
            "cannot be told which belong together; give both time stamps, or both the same frames"
        )
    what = f"its {len(counted)} poses are matched to those of {timed.path} in order"
    on_event(Warn(f"{counted.path} has no time stamps: {what}"))
