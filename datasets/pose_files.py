"""Which pose belongs to which frame: by name, time stamp or number, and by order only where there is none of these."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..recon.core.errors import DataError
from ..recon.core.pose import NO_POSE, Pose
from ..recon.core.pose_tables import PoseTable, read_pose, read_pose_table
from ..recon.core.time_stamps import SECONDS, common_units, explain_mismatch, unit_of
from ..recon.core.trajectory import Trajectory
from .images import list_files
from .names import match_names, numbers_of_names
from .poses import MAX_POSE_GAP_S, interpolate_poses

POSE_SUFFIXES = (".txt", ".csv", ".dat", ".pose")
MAX_FRAME_NUMBER = 1e11  # larger numbers in names are time stamps


@dataclass(frozen=True)
class FramePoses:
    """A pose for each frame, and what was assumed to find it."""

    poses: list[Pose]
    notes: tuple[str, ...] = ()


def _unchanged(matrix: np.ndarray) -> np.ndarray:
    return matrix


def poses_of_files(
    folder: Path, stems: Sequence[str], convert: Callable[[np.ndarray], np.ndarray] = _unchanged
) -> FramePoses:
    """The pose of each frame from the file of `folder` with its name or number; `convert` changes axes.

    Raises DataError if there are files, but none is of a frame.
    """
    files = list_files(folder, POSE_SUFFIXES)
    if not files:
        others = [path.name for path in folder.iterdir() if path.is_file()] if folder.is_dir() else []
        unread = f"{folder} holds no pose files ({', '.join(POSE_SUFFIXES)}), but {min(others)}" if others else ""
        return FramePoses([NO_POSE] * len(stems), (unread,) if unread else ())
    matched = match_names(stems, files)
    if not matched:
        first = next(iter(files.values())).name
        raise DataError(f"{folder}: no pose file is called like an image (files like {first}, images like {stems[0]})")
    poses = [read_pose(matched[stem]) if stem in matched else Pose(None, f"{folder} has none") for stem in stems]
    unused = [file for file in files.values() if file not in matched.values()]
    notes = (f"{len(unused)} of {len(files)} pose files belong to no image (the first: {unused[0]})",) if unused else ()
    return FramePoses([_converted(pose, convert) for pose in poses], notes)


def _converted(pose: Pose, convert: Callable[[np.ndarray], np.ndarray]) -> Pose:
    return pose if pose.T_world_camera is None else Pose(convert(pose.T_world_camera), pose.remark)


def poses_of_table(
    path: Path, stems: Sequence[str], stamps: np.ndarray | None, max_gap_s: float = MAX_POSE_GAP_S
) -> FramePoses:
    """The pose of each frame from one file of poses.

    `stems` are the names of the images, `stamps` (N,) their time stamps, seconds, or None. Poses belong to frames by
    name, time stamp or number; by order only where they have none of these. Raises DataError if none belongs to a frame
    or it cannot be told which.
    """
    try:
        table = read_pose_table(path)
        if table.names:
            return _by_name(table, stems)
        if table.labels is None:
            return _by_order(table, stems)
        if stamps is not None:
            return _by_time(table, stamps, stems, max_gap_s)
        return _by_number(table, stems)
    except DataError as error:
        raise DataError(f"{error}; or remove {path.name} to go on without poses") from error


def _by_name(table: PoseTable, stems: Sequence[str]) -> FramePoses:
    poses = {Path(name.replace("\\", "/")).stem: pose for name, pose in zip(table.names, table.poses, strict=True)}
    matched = match_names(stems, poses)
    if not matched:
        raise DataError(f"{table.path}: none of its names is that of an image ({table.names[0]}, images: {stems[0]})")
    return _found(table, [matched.get(stem) for stem in stems], len(matched))


def _by_number(table: PoseTable, stems: Sequence[str]) -> FramePoses:
    labels, counted = np.asarray(table.labels), [float(index) for index in range(len(stems))]
    numbers = numbers_of_names(stems) or counted
    if not np.isfinite(labels).all():
        raise DataError(f"{table.path}: {(~np.isfinite(labels)).sum()} of its {len(table)} poses have no finite number")
    poses = {_rounded(label): pose for label, pose in zip(labels, table.poses, strict=True)}
    matched = [poses.get(_rounded(number)) for number in numbers]
    count = sum(pose is not None for pose in matched)
    ranges = f"poses from {labels.min():g} to {labels.max():g}, images from {numbers[0]:g} to {numbers[-1]:g}"
    if len(poses) < len(table):
        raise DataError(f"{table.path}: {len(table) - len(poses)} of its {len(table)} poses have the number of another")
    are_times = bool((labels % 1 != 0).any()) or max(numbers) > MAX_FRAME_NUMBER
    if are_times and count < min(len(numbers), len(poses)):
        return _by_time(table, np.array(numbers) * unit_of(np.array(numbers)).seconds, stems, MAX_POSE_GAP_S)
    if count == 0 and set(poses) <= set(counted):
        note = f"{table.path}: its numbers are not those of the images ({ranges}): they count the images from 0"
        found = _found(table, [poses.get(number) for number in counted], len(poses))
        return FramePoses(found.poses, (note, *found.notes))
    if count == 0 or (count < len(numbers) == len(poses) and _is_shifted(np.array(numbers), labels)):
        raise DataError(
            f"{table.path}: the numbers of its poses are not those of the images ({ranges}), so it cannot be told "
            "which belong together; give both the same numbers"
        )
    return _found(table, matched, count)


def _rounded(number: float) -> float:
    return round(float(number), 6)


def _is_shifted(numbers: np.ndarray, labels: np.ndarray) -> bool:
    """Whether the numbers of images and poses are the same but for a constant, or the poses are simply counted."""
    shifts = np.sort(numbers) - np.sort(labels)
    counted = np.arange(len(labels))
    return bool(np.ptp(shifts) == 0 or any((np.sort(labels) == counted + start).all() for start in (0, 1)))


def _by_order(table: PoseTable, stems: Sequence[str]) -> FramePoses:
    count, numbers = len(table.poses), numbers_of_names(stems)
    numbered = [int(number) for number in numbers] if numbers and all(n % 1 == 0 for n in numbers) else []
    if count == len(stems):
        counts_from_zero = not numbered or numbered == list(range(count))
        note = f"{table.path}: line n of its {count} poses belongs to the n-th image, as images are numbered otherwise"
        return FramePoses(list(table.poses), table.notes if counts_from_zero else (*table.notes, note))
    if numbered and (max(numbered) < count or min(numbered) == 0):
        poses = [table.poses[number] if number < count else None for number in numbered]
        used = sum(pose is not None for pose in poses)
        note = f"{table.path} has {count} poses for {len(stems)} images: line n belongs to image number n, from 0"
        return FramePoses(_found(table, poses, used).poses, (*table.notes, note))
    raise DataError(
        f"{table.path} holds {count} poses without number or time stamp, but there are {len(stems)} images: it cannot "
        "be told which belong together; begin each line with the number of its image"
    )


def _by_time(table: PoseTable, stamps: np.ndarray, stems: Sequence[str], max_gap_s: float) -> FramePoses:
    labels = np.asarray(table.labels)
    finite = labels[np.isfinite(labels)]
    if not finite.size:
        raise DataError(f"{table.path} holds no finite time stamp")
    _, unit = common_units(stamps, finite)
    notes = table.notes + table.remarks
    if unit != SECONDS:
        notes += (f"time stamps of {table.path} are read as {unit.name}",)
    seconds = labels * unit.seconds
    poses = interpolate_poses(Trajectory(seconds, table.T_world_camera), stamps, max_gap_s)
    if all(pose.T_world_camera is None for pose in poses):
        numbers = numbers_of_names(stems)
        if numbers is not None and set(numbers) <= set(labels.tolist()):
            found = _by_number(table, stems)
            return FramePoses(found.poses, (f"{table.path}: its numbers are those of the images", *found.notes))
        usable = seconds[np.isfinite(seconds)]
        rule = "poses are not interpolated across"
        raise DataError(explain_mismatch(str(table.path), usable, "the images", stamps, max_gap_s, rule))
    return FramePoses(poses, notes)


def _found(table: PoseTable, poses: Sequence[Pose | None], count: int) -> FramePoses:
    """Poses of the frames; those that the table lacks are None. Notes poses that belong to no frame."""
    unused = len(table.poses) - count
    notes = (f"{unused} of {len(table.poses)} poses of {table.path} belong to no image",) if unused else ()
    missing = Pose(None, f"{table.path} has none")
    return FramePoses([missing if pose is None else pose for pose in poses], table.notes + notes)
