"""Files of camera poses as trajectory tools write them; the content tells the format, the name does not.

| format | a pose is |
|---|---|
| TUM | `timestamp tx ty tz qx qy qz qw`; RTAB-Map appends an `id` |
| EuRoC | CSV: nanoseconds, then columns as the header names them, without one `tx, ty, tz, qw, qx, qy, qz, ...` |
| KITTI | the 12 numbers of a 3x4 or 16 of a 4x4 matrix; in KITTI-360 with the number of the frame before |
| Open3D `.log` | a line of three numbers, the first that of the frame, and the four lines of a matrix |
| matrices | four lines of four numbers |
| g2o, TORO | lines `VERTEX_SE3:QUAT` and `VERTEX3` of a graph, as RTAB-Map exports it |
| names | any line of numbers after the name of an image |
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .errors import DataError
from .pose import NORM_TOLERANCE, Pose, pose_from_vectors, usable_pose
from .text import NumberTable, TextLine, parse_number, read_table, read_text, text_lines

_EXPECTED = (
    "poses `timestamp tx ty tz qx qy qz qw` (TUM), a matrix of 12 or 16 numbers (KITTI), or another format of "
    "docs/evaluation.md"
)
_MATRIX_WIDTHS = {12: 0, 16: 0, 13: 1, 17: 1}  # numbers in a line: of them before the matrix
_UNITS_S = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3}
_UNIT_WORDS = ("m", "s", "rad", "deg", *_UNITS_S)
_EUROC_STAMP = 1e17  # nanoseconds since 1970


@dataclass(frozen=True)
class PoseTable:
    """The poses of a file in its order.

    labels     (N,) time stamps or frame numbers as in the file; None if it has none
    are_times  whether the format has time stamps for labels; whole numbers can still count frames
    unit_s     length of the unit of time stamps in seconds, where the header names it
    names      N names, of images for example; empty if it has none
    notes      what was assumed or left out to read it, one line each
    """

    path: Path
    poses: tuple[Pose, ...]
    labels: np.ndarray | None = None
    are_times: bool = False
    unit_s: float | None = None
    names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.poses)

    @cached_property
    def T_world_camera(self) -> np.ndarray:
        """(N, 4, 4) float64, not a number where a pose cannot be used."""
        nothing = np.full((4, 4), np.nan)
        return np.stack([nothing if pose.T_world_camera is None else pose.T_world_camera for pose in self.poses])

    @property
    def remarks(self) -> tuple[str, ...]:
        """A line on poses that cannot be used, and one on those that were corrected."""
        lines = []
        for what, is_usable in (("cannot be used", False), ("were corrected", True)):
            found = [
                pose.remark for pose in self.poses if pose.remark and (pose.T_world_camera is not None) == is_usable
            ]
            if found:
                lines.append(f"{len(found)} of {len(self)} poses {what} (the first: {found[0]})")
        return tuple(lines)


def read_pose_table(path: Path) -> PoseTable:
    """Read the poses of a text file. Raises DataError if it is nothing of that kind, or no pose can be used."""
    lines = text_lines(path)
    if not lines:
        raise DataError(f"{path} holds no poses")
    is_graph = any(line.text.startswith("VERTEX") for line in lines)
    table = _read_graph(path, lines) if is_graph else _read_rows(_read_numbers(path))
    if all(pose.T_world_camera is None for pose in table.poses):
        first = table.poses[0].remark
        raise DataError(f"none of the {len(table)} poses of {path} can be used (the first: {first})")
    return table


def read_pose(path: Path) -> Pose:
    """The pose of a file that holds one: a 4x4 or 3x4 matrix, or a translation and a quaternion."""
    try:
        table = read_table(path, _is_one_pose, "a 4x4 or 3x4 matrix, or `tx ty tz qx qy qz qw`")
        values = np.concatenate([np.array(row) for row in table.rows])
        pose = usable_pose(values.reshape(-1, 4)) if values.size != 7 else _from_rows(path, values[None])[0][0]
    except DataError as error:
        return Pose(None, str(error))
    return pose.located(str(path))


def _is_one_pose(widths: Sequence[int]) -> bool:
    return tuple(widths) in {(4,) * 4, (4,) * 3, (16,), (12,), (7,), (1,) * 7, (3, 4), (4, 3)}


def _read_rows(table: NumberTable) -> PoseTable:
    widths = [len(row) for row in table.rows]
    if len(set(widths)) > 1 or widths[0] in (3, 4):
        return _read_blocks(table, 4 if widths[0] == 4 else 5)
    values = np.array(table.rows)
    columns = _named_columns(table)
    if columns or widths[0] not in _MATRIX_WIDTHS:
        return _read_vectors(table, values, columns)
    before = _MATRIX_WIDTHS[widths[0]]
    poses = [usable_pose(row[before:].reshape(-1, 4)) for row in values]
    return PoseTable(table.path, _located(table, poses), values[:, 0] if before else None, names=table.names)


def _read_numbers(path: Path) -> NumberTable:
    """The usual widths first: with decimal commas a line of 8 numbers could be read as one of 16."""
    for width in (8, 12, 16):
        with suppress(DataError):
            return read_table(path, lambda widths, width=width: set(widths) == {width}, _EXPECTED)  # type: ignore[misc]
    return read_table(path, _is_pose_table, _EXPECTED)


def _is_pose_table(widths: Sequence[int]) -> bool:
    if len(set(widths)) > 1:
        return len(widths) % 5 == 0 and tuple(widths) == (3, 4, 4, 4, 4) * (len(widths) // 5)
    return widths[0] in (7, *_MATRIX_WIDTHS) or widths[0] >= 8 or (widths[0] == 4 and len(widths) % 4 == 0)


def _located(table: NumberTable, poses: Sequence[Pose], step: int = 1) -> tuple[Pose, ...]:
    """The poses with the line of each in its remark; each takes `step` lines."""
    lines = table.lines[::step]
    return tuple(pose.located(f"{table.path}, line {line}") for pose, line in zip(poses, lines, strict=True))


def _read_blocks(table: NumberTable, height: int) -> PoseTable:
    """Matrices over four lines, each after a line of three numbers if `height` is 5; the first is the frame's."""
    blocks = [table.rows[start : start + height] for start in range(0, len(table.rows), height)]
    poses = _located(table, [usable_pose(np.array(block[-4:])) for block in blocks], height)
    if height == 4:
        return PoseTable(table.path, poses)
    heads = np.array([block[0] for block in blocks])
    numbers = heads[:, 0]
    if len(np.unique(numbers)) == len(numbers):
        return PoseTable(table.path, poses, numbers)
    if len(np.unique(heads[:, :2], axis=0)) > 1:
        raise DataError(
            f"{table.path}: several matrices belong to frame {numbers[0]:g}: motions between pairs of frames are no "
            "trajectory"
        )
    return PoseTable(
        table.path, poses, notes=(f"{table.path}: all matrices have the same number; they count in order",)
    )


def _read_vectors(table: NumberTable, values: np.ndarray, columns: list[int]) -> PoseTable:
    """Translations and quaternions in the `columns` that the header names, else in the order that the numbers show."""
    width, path = values.shape[1], table.path
    has_label = min(columns) > 0 if columns else width > 7
    labels = values[:, 0] if has_label else None
    notes: tuple[str, ...] = ()
    if columns:
        poses = _from_vectors(values[:, columns[:3]], values[:, columns[3:]])
    else:
        first = int(has_label)
        is_euroc = labels is not None and width != 9 and np.nanmedian(labels) > _EUROC_STAMP and "," in read_text(path)
        poses, notes = _from_rows(path, values[:, first : first + 7], is_euroc=is_euroc)
        if width > 9:
            notes += (f"{path}: columns behind the first {first + 7} are not used, as no line names them",)
    unit_s = _UNITS_S.get(table.header[1]) if has_label and len(table.header) > 1 else None
    return PoseTable(path, _located(table, poses), labels, has_label, unit_s, table.names, notes)


def _named_columns(table: NumberTable) -> list[int]:
    """Columns of tx, ty, tz, qx, qy, qz, qw if the header names them all; else empty."""
    words = [word for word in table.header if word not in _UNIT_WORDS]
    if len(words) != len(table.rows[0]) + bool(table.names):
        return []
    ends = [word.rsplit("_", 1)[-1] for word in words]
    rotates = [word.startswith(("q", "rot")) for word in words]
    columns = []
    for axis, is_rotation in [*((axis, False) for axis in "xyz"), *((axis, True) for axis in "xyzw")]:
        names = (axis, f"q{axis}", f"r{axis}") if is_rotation else (axis, f"t{axis}", f"p{axis}")
        found = [at for at, end in enumerate(ends) if end in names and rotates[at] == is_rotation]
        if not found:
            return []
        columns.append(found[0] - bool(table.names))
    return columns


def _from_rows(path: Path, values: np.ndarray, *, is_euroc: bool = False) -> tuple[list[Pose], tuple[str, ...]]:
    """Poses of rows (N, 7) of a translation and a quaternion in the order that the numbers show, and what was assumed.

    The four that are of unit length are the quaternion. It is x, y, z, w as in TUM text, unless the rows begin with it,
    come from a CSV of EuRoC, or the first pose, at the origin, is 1 0 0 0: the identity as w, x, y, z. Raises DataError
    if no four numbers are of unit length.
    """
    finite = values[np.isfinite(values).all(axis=1)]
    is_last, is_first = _are_unit(finite[:, 3:]), _are_unit(finite[:, :4])
    if is_first and not is_last:
        note = f"{path} is read as `qw qx qy qz tx ty tz`, as its first four numbers are unit quaternions"
        return _from_vectors(values[:, 4:], np.roll(values[:, :4], -1, axis=1)), (note,)
    if len(finite) and not is_last:
        raise DataError(f"{path}: no four of its numbers are a unit quaternion; expected {_EXPECTED}")
    w_first = _from_vectors(values[:, :3], np.roll(values[:, 3:], -1, axis=1))
    if is_euroc:
        note = f"{path} is read as EuRoC, `tx ty tz qw qx qy qz`: nanoseconds, separated by commas, without a header"
        return w_first, (note,)
    if len(finite) > 1 and np.allclose(finite[0], [0, 0, 0, 1, 0, 0, 0], atol=1e-6):
        note = f"{path} is read as `tx ty tz qw qx qy qz`, as it begins with 0 0 0 1 0 0 0, the identity"
        return w_first, (note,)
    return _from_vectors(values[:, :3], values[:, 3:]), ()


def _are_unit(quaternions: np.ndarray) -> bool:
    """Whether most rows (N, 4) are of unit length."""
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(quaternions, axis=1)
    return bool(norms.size) and bool((np.abs(norms - 1) < NORM_TOLERANCE).mean() > 0.5)


def _from_vectors(translations: np.ndarray, quaternions: np.ndarray) -> list[Pose]:
    return [pose_from_vectors(*vectors) for vectors in zip(translations, quaternions, strict=True)]


def _read_graph(path: Path, lines: Sequence[TextLine]) -> PoseTable:
    """The vertices of a g2o or TORO file; their ids are the numbers of the frames."""
    numbers, poses = [], []
    for line in lines:
        word, *rest = line.text.split()
        size = {"VERTEX_SE3:QUAT": 8, "VERTEX3": 7}.get(word)
        if size is None:
            continue
        values = [parse_number(part) for part in rest]
        if len(values) != size or None in values:
            raise DataError(f"{path}, line {line.number}: expected {size} numbers after {word}")
        row = np.array(values, dtype=float)
        numbers.append(row[0])
        quaternion = row[4:] if size == 8 else Rotation.from_euler("xyz", row[4:]).as_quat()
        poses.append(pose_from_vectors(row[1:4], quaternion).located(f"{path}, line {line.number}"))
    if not poses:
        raise DataError(f"{path} is a graph without poses in space (VERTEX_SE3:QUAT or VERTEX3)")
    note = f"{path}: poses of a graph are those of its vertices, matched by their ids; edges are not used"
    return PoseTable(path, tuple(poses), np.array(numbers), notes=(note,))
