"""Two files of poses, brought to common time stamps or frame numbers so that they can be compared."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..core.errors import DataError
from ..core.events import OnEvent, Warn, ignore
from ..core.pose_tables import PoseTable, read_pose_table
from ..core.time_stamps import SECONDS, common_units, unit_of
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
    for note in (note for table in tables for note in (*table.notes, *table.remarks)):
        on_event(Warn(note))
    timed, counted = tables if tables[0].are_times else tables[::-1]
    if timed.are_times and not counted.are_times and _has_clock(timed):
        _require_same_count(timed, counted, on_event)
        labels = [_seconds(timed, None, on_event)] * 2
    elif timed.are_times and counted.are_times:
        labels = [_seconds(first, second, on_event) for first, second in (tables, tables[::-1])]
    else:  # whole numbers in the place of time stamps count frames
        labels = [_numbers(table) for table in tables]
        _warn_of_counts(tables, on_event)
    estimate, reference = (Trajectory(label, table.T_world_camera) for label, table in zip(labels, tables, strict=True))
    return estimate, reference


def _has_clock(table: PoseTable) -> bool:
    return table.unit_s is not None or has_clock(_finite(table))


def _finite(table: PoseTable) -> np.ndarray:
    """The finite time stamps or frame numbers of a table that has them."""
    labels = np.asarray(table.labels)
    return labels[np.isfinite(labels)]


def _seconds(table: PoseTable, other: PoseTable | None, on_event: OnEvent) -> np.ndarray:
    """(N,) time stamps of `table`; their unit is named by its header, or found from them and those of the `other`."""
    labels = np.asarray(table.labels)
    if table.unit_s is not None:
        return labels * table.unit_s
    if other is None or other.unit_s is not None:
        unit = unit_of(_finite(table))
    else:
        unit, _ = common_units(_finite(table), _finite(other))
    if unit != SECONDS:
        on_event(Warn(f"time stamps of {table.path} are read as {unit.name}"))
    return labels * unit.seconds


def _numbers(table: PoseTable) -> np.ndarray:
    """(N,) frame numbers: as the file has them, the last number in each name, or counted from 0."""
    if table.labels is not None:
        return table.labels
    found = [re.findall(r"\d+", Path(name.replace("\\", "/")).stem)[-1:] for name in table.names]
    numbers = np.array([float(digits[0]) for digits in found if digits])
    return numbers if len(np.unique(numbers)) == len(table) else np.arange(len(table), dtype=float)


def _warn_of_counts(tables: tuple[PoseTable, PoseTable], on_event: OnEvent) -> None:
    """Poses that count from 0 can be of other frames, if the files have different numbers of them."""
    counted = [table for table in tables if table.labels is None and not table.names]
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
