"""Files of camera poses as tools write them: a matrix each, or a table of them with time stamps, numbers or names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..recon.core.errors import DataError
from ..recon.core.text import NumberTable, read_table
from ..recon.core.time_stamps import SECONDS, common_units, explain_mismatch, unit_of
from ..recon.core.trajectory import Trajectory
from .images import list_files
from .names import match_names, numbers_of_names
from .poses import MAX_POSE_GAP_S, NO_POSE, NORM_TOLERANCE, Pose, interpolate_poses, pose_from_vectors, usable_pose

POSE_SUFFIXES = (".txt", ".csv", ".dat", ".pose")
_MATRIX = "a 4x4 or 3x4 matrix, or `tx ty tz qx qy qz qw`"
_TABLE = "`timestamp tx ty tz qx qy qz qw`, or a matrix of 12 or 16 numbers"
_LABELLED, _UNLABELLED = (8, 13, 17), (7, 12, 16)  # numbers in a line with and without time stamp or frame number


@dataclass(frozen=True)
class PoseTable:
    """Poses of one file in its order.

    labels   (N,) time stamps or frame numbers as in the file; None if it has none
    names    N names, of images for example; empty if it has none
    notes    what was assumed to read it
    """

    path: Path
    poses: tuple[Pose, ...]
    labels: np.ndarray | None = None
    names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class FramePoses:
    """A pose for each frame, and what was assumed to find it."""

    poses: list[Pose]
    notes: tuple[str, ...] = ()


def read_pose(path: Path) -> Pose:
    """The pose of a file that holds one: a 4x4 or 3x4 matrix, or a translation and a quaternion."""
    try:
        table = read_table(path, _is_one_pose, _MATRIX)
        values = np.concatenate([np.array(row) for row in table.rows])
        pose = usable_pose(values.reshape(-1, 4)) if values.size != 7 else _vectors(table, values[None])[0][0]
    except DataError as error:
        return Pose(None, str(error))
    return pose.located(str(path))


def _is_one_pose(widths: Sequence[int]) -> bool:
    return tuple(widths) in {(4,) * 4, (4,) * 3, (16,), (12,), (7,), (1,) * 7, (3, 4), (4, 3)}


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


def read_pose_table(path: Path) -> PoseTable:
    """The poses of a text file: TUM text, a matrix a line, or blocks of lines (`trajectory.log` of Open3D).

    Raises DataError if it is nothing of that kind.
    """
    table = read_table(path, _is_pose_table, _TABLE)
    widths = [len(row) for row in table.rows]
    if len(set(widths)) > 1 or widths[0] in (3, 4):
        return _blocks(table, 4 if widths[0] == 4 else 5)
    values = np.array(table.rows)
    labels: np.ndarray | None = None
    notes: tuple[str, ...] = ()
    if columns := _named_columns(table):
        poses = _from_vectors(values[:, columns[:3]], values[:, columns[3:]])
        labels = values[:, 0] if min(columns) > 0 else None
    elif widths[0] in (8, 7):
        labels = values[:, 0] if widths[0] == 8 else None
        poses, notes = _vectors(table, values[:, -7:])
    else:
        if widths[0] not in (*_LABELLED, *_UNLABELLED):
            raise DataError(f"{path} holds {widths[0]} numbers a line and no line that names them; expected {_TABLE}")
        labels = values[:, 0] if widths[0] in _LABELLED else None
        size = widths[0] - (labels is not None)
        poses = [usable_pose(row[-size:].reshape(-1, 4)) for row in values]
    located = tuple(pose.located(f"{path}, line {line}") for pose, line in zip(poses, table.lines, strict=True))
    return PoseTable(path, located, labels, table.names, notes)


def _is_pose_table(widths: Sequence[int]) -> bool:
    if len(set(widths)) == 1:
        return widths[0] in (*_LABELLED, *_UNLABELLED) or widths[0] > 8 or (widths[0] == 4 and len(widths) % 4 == 0)
    return len(widths) % 5 == 0 and tuple(widths) == (3, 4, 4, 4, 4) * (len(widths) // 5)


def _blocks(table: NumberTable, height: int) -> PoseTable:
    """Matrices over four lines, each after a line of three numbers if `height` is 5: the first is the frame's."""
    starts = range(0, len(table.rows), height)
    poses = [
        usable_pose(np.array(table.rows[start + height - 4 : start + height])).located(
            f"{table.path}, line {table.lines[start]}"
        )
        for start in starts
    ]
    labels = np.array([table.rows[start][0] for start in starts]) if height == 5 else None
    return PoseTable(table.path, tuple(poses), labels)


def _named_columns(table: NumberTable) -> list[int]:
    """Columns of tx, ty, tz, qx, qy, qz, qw if the header names them all; else empty."""
    words = [word for word in table.header if word not in ("m", "s", "ns", "rad", "deg")]
    width = len(table.rows[0]) + bool(table.names)
    if len(words) != width:
        return []
    ends = [word.rsplit("_", 1)[-1] if "_" in word else word for word in words]
    is_rotation = [word.startswith(("q", "rot")) for word in words]
    columns = []
    for axis, rotates in [*((axis, False) for axis in "xyz"), *((axis, True) for axis in "xyzw")]:
        names = (axis, f"q{axis}", f"r{axis}") if rotates else (axis, f"t{axis}", f"p{axis}")
        found = [i for i, end in enumerate(ends) if end in names and is_rotation[i] == rotates]
        if not found:
            return []
        columns.append(found[0] - bool(table.names))
    return columns


def _vectors(table: NumberTable, values: np.ndarray) -> tuple[list[Pose], tuple[str, ...]]:
    """Poses of rows (N, 7) of a translation and a quaternion, in the order that the numbers show; and the note.

    The four that are of unit length are the quaternion. It is x, y, z, w as in TUM text, unless the rows begin with it
    or the first pose, at the origin, is 1 0 0 0: the identity as w, x, y, z.
    """
    finite = values[np.isfinite(values).all(axis=1)]
    last, first = (_are_unit(finite[:, columns]) for columns in (slice(3, 7), slice(0, 4)))
    if first and not last:
        note = f"{table.path} is read as `qw qx qy qz tx ty tz`, as its first four numbers are unit quaternions"
        return _from_vectors(values[:, 4:], np.roll(values[:, :4], -1, axis=1)), (note,)
    start = finite[0] if len(finite) else np.zeros(7)
    if np.allclose(start, [0, 0, 0, 1, 0, 0, 0], atol=1e-6) and len(finite) > 1:
        note = f"{table.path} is read as `tx ty tz qw qx qy qz`, as it begins with 0 0 0 1 0 0 0, the identity"
        return _from_vectors(values[:, :3], np.roll(values[:, 3:], -1, axis=1)), (note,)
    return _from_vectors(values[:, :3], values[:, 3:]), ()


def _are_unit(quaternions: np.ndarray) -> bool:
    """Whether most rows (N, 4) are of unit length."""
    norms = np.linalg.norm(quaternions, axis=1)
    return bool(norms.size) and bool((np.abs(norms - 1) < NORM_TOLERANCE).mean() > 0.5)


def _from_vectors(translations: np.ndarray, quaternions: np.ndarray) -> list[Pose]:
    return [pose_from_vectors(*vectors) for vectors in zip(translations, quaternions, strict=True)]


def poses_of_table(
    path: Path, stems: Sequence[str], stamps: np.ndarray | None, max_gap_s: float = MAX_POSE_GAP_S
) -> FramePoses:
    """The pose of each frame from one file of poses.

    `stems` are the names of the images, `stamps` (N,) their time stamps, seconds, or None. Poses belong to frames by
    name, time stamp or number; by order only where they have none of these. Raises DataError if none belongs to a frame
    or it cannot be told which.
    """
    table = read_pose_table(path)
    if table.names:
        return _by_name(table, stems)
    if table.labels is None:
        return _by_order(table, stems)
    if stamps is not None:
        return _by_time(table, stamps, stems, max_gap_s)
    return _by_number(table, stems)


def _by_name(table: PoseTable, stems: Sequence[str]) -> FramePoses:
    poses = {Path(name.replace("\\", "/")).stem: pose for name, pose in zip(table.names, table.poses, strict=True)}
    matched = match_names(stems, poses)
    if not matched:
        raise DataError(f"{table.path}: none of its names is that of an image ({table.names[0]}, images: {stems[0]})")
    return _found(table, [matched.get(stem) for stem in stems], len(matched))


def _by_number(table: PoseTable, stems: Sequence[str]) -> FramePoses:
    labels, counted = np.asarray(table.labels), [float(index) for index in range(len(stems))]
    numbers = numbers_of_names(stems) or counted
    poses = {_rounded(label): pose for label, pose in zip(labels, table.poses, strict=True)}
    matched = [poses.get(_rounded(number)) for number in numbers]
    count = sum(pose is not None for pose in matched)
    ranges = f"poses from {labels.min():g} to {labels.max():g}, images from {numbers[0]:g} to {numbers[-1]:g}"
    if count < min(len(numbers), len(poses)) and (labels % 1 != 0).any():
        return _by_time(table, np.array(numbers) * unit_of(np.array(numbers)).seconds, stems, MAX_POSE_GAP_S)
    if count == 0 and set(poses) <= set(counted):
        note = f"{table.path}: its numbers are not those of the images ({ranges}): they count the images from 0"
        found = _found(table, [poses.get(number) for number in counted], len(poses))
        return FramePoses(found.poses, (note, *found.notes))
    if count == 0 or (count < len(numbers) == len(poses) and _is_shifted(np.array(numbers), labels)):
        raise DataError(
            f"{table.path}: the numbers of its poses are not those of the images ({ranges}), so it cannot be told "
            f"which belong together; give both the same numbers, or remove {table.path.name} to go on without poses"
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
        f"be told which belong together; begin each line with the number of its image, or remove {table.path.name}"
    )


def _by_time(table: PoseTable, stamps: np.ndarray, stems: Sequence[str], max_gap_s: float) -> FramePoses:
    labels = np.asarray(table.labels)
    finite = labels[np.isfinite(labels)]
    if not finite.size:
        raise DataError(f"{table.path} holds no finite time stamp; remove it to go on without poses")
    _, unit = common_units(stamps, finite)
    notes = table.notes
    if unit != SECONDS:
        notes += (f"time stamps of {table.path} are read as {unit.name}",)
    seconds = labels * unit.seconds
    nothing = np.full((4, 4), np.nan)
    matrices = np.stack([nothing if p.T_world_camera is None else p.T_world_camera for p in table.poses])
    poses = interpolate_poses(Trajectory(seconds, matrices), stamps, max_gap_s)
    unusable = [pose.remark for pose in table.poses if pose.T_world_camera is None]
    if all(pose.T_world_camera is None for pose in poses):
        numbers = numbers_of_names(stems)
        if numbers is not None and set(numbers) <= set(labels.tolist()):
            found = _by_number(table, stems)
            return FramePoses(found.poses, (f"{table.path}: its numbers are those of the images", *found.notes))
        go_on = f", or remove {table.path.name} to go on without poses"
        if len(unusable) == len(table.poses):
            raise DataError(f"none of the {len(unusable)} poses can be used; the first: {unusable[0]}{go_on}")
        usable = seconds[np.isfinite(seconds)]
        rule = "poses are not interpolated across"
        raise DataError(explain_mismatch(str(table.path), usable, "the images", stamps, max_gap_s, rule) + go_on)
    if unusable:
        notes += (f"{len(unusable)} of {len(table.poses)} poses cannot be used; the first: {unusable[0]}",)
    return FramePoses(poses, notes)


def _found(table: PoseTable, poses: Sequence[Pose | None], count: int) -> FramePoses:
    """Poses of the frames; those that the table lacks are None. Notes poses that belong to no frame."""
    unused = len(table.poses) - count
    notes = (f"{unused} of {len(table.poses)} poses of {table.path} belong to no image",) if unused else ()
    missing = Pose(None, f"{table.path} has none")
    return FramePoses([missing if pose is None else pose for pose in poses], table.notes + notes)
