"""Files of camera poses as trajectory tools write them; the content tells the format, the name does not.

| format | a pose is |
|---|---|
| TUM | `timestamp tx ty tz qx qy qz qw`; RTAB-Map appends an `id` |
| EuRoC | CSV: nanoseconds, then columns as the header names them, without one `tx, ty, tz, qw, qx, qy, qz, ...` |
| KITTI | the 12 numbers of a 3x4 or 16 of a 4x4 matrix; in KITTI-360 with the number of the frame before |
| Open3D `.log` | a line of three numbers, the first that of the frame, and the four lines of a matrix |
| matrices | four lines of four numbers |
| g2o, TORO | lines `VERTEX_SE3:QUAT` and `VERTEX3` of a graph, as RTAB-Map exports it |
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .errors import DataError
from .text import NumberTable, TextLine, parse_number, read_table, read_text, text_lines

ORTHONORMAL_TOLERANCE = 2e-2  # two decimals, rounded; anything beyond is no rotation
NORM_TOLERANCE = 0.05  # of quaternions in text
MAX_POSITION_M = 1e9  # further than any place on Earth, in millimetres too: the file is damaged
_EXPECTED = (
    "poses `timestamp tx ty tz qx qy qz qw` (TUM), a matrix of 12 or 16 numbers (KITTI), or another format of "
    "docs/evaluation.md"
)
_MATRIX_WIDTHS = {12: 0, 16: 0, 13: 1, 17: 1}  # numbers in a line: of them before the matrix
_UNIT_WORDS = ("m", "s", "ns", "us", "ms", "rad", "deg")
# Time stamps since 1970 by their size: nano-, micro- and milliseconds.
_UNITS_BY_SIZE = ((1e17, 1e-9, "nanoseconds"), (1e14, 1e-6, "microseconds"), (1e11, 1e-3, "milliseconds"))


@dataclass(frozen=True)
class PoseTable:
    """The poses of a file in its order.

    T_world_camera  (N, 4, 4) float64; not a number where a pose cannot be used
    times           (N,) seconds; None if the file has none
    numbers         (N,) frame numbers; None if the file has none
    notes           what was assumed or left out to read it, one line each
    """

    path: Path
    T_world_camera: np.ndarray
    times: np.ndarray | None = None
    numbers: np.ndarray | None = None
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.T_world_camera)


def read_pose_table(path: Path) -> PoseTable:
    """Read the poses of a text file. Raises DataError if it holds none, or it cannot be told what its numbers are."""
    lines = text_lines(path)
    if not lines:
        raise DataError(f"{path} holds no poses")
    if any(line.text.startswith("VERTEX") for line in lines):
        return _checked(_read_graph(path, lines))
    table = _read_numbers(path)
    widths = [len(row) for row in table.rows]
    if len(set(widths)) > 1:
        return _checked(_read_blocks(table, 5))
    if widths[0] == 4:
        return _checked(_read_blocks(table, 4))
    values = np.array(table.rows)
    columns = _named_columns(table)
    if columns or values.shape[1] not in _MATRIX_WIDTHS:
        poses = _read_vectors(table, values, columns)
    else:
        before = _MATRIX_WIDTHS[values.shape[1]]
        matrices = _matrices(values[:, before:].reshape(len(values), -1, 4))
        poses = PoseTable(path, matrices, None, values[:, 0] if before else None)
    if table.names and poses.times is None and poses.numbers is None:
        poses = replace(poses, numbers=_numbers_of_names(table.names))
    return _checked(poses)


def _numbers_of_names(names: Sequence[str]) -> np.ndarray | None:
    """The last number in each name; None unless all have one of their own."""
    found = [re.findall(r"\d+", Path(name.replace("\\", "/")).stem)[-1:] for name in names]
    numbers = np.array([float(digits[0]) for digits in found if digits])
    return numbers if len(np.unique(numbers)) == len(names) else None


def _read_numbers(path: Path) -> NumberTable:
    """The usual widths first: with decimal commas a line of 8 numbers could be read as one of 16."""
    for width in (8, 12, 16):
        with suppress(DataError):
            return read_table(path, lambda widths, width=width: set(widths) == {width}, _EXPECTED)  # type: ignore[misc]
    return read_table(path, _is_pose_table, _EXPECTED)


def _is_pose_table(widths: Sequence[int]) -> bool:
    if len(set(widths)) > 1:
        return tuple(widths) == (3, 4, 4, 4, 4) * (len(widths) // 5)
    return widths[0] in (7, *_MATRIX_WIDTHS) or widths[0] >= 8 or (widths[0] == 4 and len(widths) % 4 == 0)


def _checked(table: PoseTable) -> PoseTable:
    """With a note on poses that cannot be used. Raises DataError if none can."""
    broken = np.flatnonzero(~np.isfinite(table.T_world_camera).all(axis=(1, 2)))
    if len(broken) == len(table):
        raise DataError(
            f"{table.path} holds no finite pose among its {len(table)}, or none with a rotation; expected {_EXPECTED}"
        )
    if len(broken) == 0:
        return table
    note = f"{table.path}: {len(broken)} of {len(table)} poses cannot be used (the first: pose {broken[0] + 1})"
    return replace(table, notes=(*table.notes, note))


def _read_blocks(table: NumberTable, height: int) -> PoseTable:
    """Matrices over four lines, each after a line of three numbers if `height` is 5; the first is the frame's."""
    rows = [table.rows[start : start + height] for start in range(0, len(table.rows), height)]
    poses = _matrices(np.array([block[-4:] for block in rows]))
    if height == 4:
        return PoseTable(table.path, poses)
    heads = np.array([block[0] for block in rows])
    numbers = heads[:, 0]
    if len(np.unique(numbers)) == len(numbers):
        return PoseTable(table.path, poses, None, numbers)
    if len(np.unique(heads[:, :2], axis=0)) > 1:
        raise DataError(
            f"{table.path}: several matrices belong to frame {numbers[0]:g}: motions between pairs of frames are no "
            "trajectory"
        )
    return PoseTable(
        table.path, poses, notes=(f"{table.path}: all matrices have the same number; they count in order",)
    )


def _matrices(blocks: np.ndarray) -> np.ndarray:
    """(N, 3, 4) or (N, 4, 4) -> (N, 4, 4) with exact rotations, not a number where there is no rigid motion."""
    poses = np.tile(np.eye(4), (len(blocks), 1, 1))
    poses[:, :3] = blocks[:, :3]
    usable = (np.abs(blocks) < MAX_POSITION_M).all(axis=(1, 2)) & (np.abs(blocks[:, :3, :3]) < 2).all(axis=(1, 2))
    if blocks.shape[1] == 4:
        usable &= (np.abs(blocks[:, 3] - [0, 0, 0, 1]) < ORTHONORMAL_TOLERANCE).all(axis=1)
    rotations = np.where(usable[:, None, None], poses[:, :3, :3], np.eye(3))
    products = np.swapaxes(rotations, 1, 2) @ rotations
    usable &= (np.abs(products - np.eye(3)) < ORTHONORMAL_TOLERANCE).all(axis=(1, 2)) & (np.linalg.det(rotations) > 0)
    u, _, vt = np.linalg.svd(np.where(usable[:, None, None], rotations, np.eye(3)))
    poses[:, :3, :3] = u @ vt
    poses[~usable] = np.nan
    return poses


def _read_vectors(table: NumberTable, values: np.ndarray, columns: list[int]) -> PoseTable:
    """Translations and quaternions in the `columns` that the header names, else in the order that the numbers show."""
    notes: list[str] = []
    width = values.shape[1]
    times = None if width == 7 else values[:, 0]
    if columns:
        if min(columns) == 0:
            times = None
    else:
        columns, note = _guess_columns(table, values)
        notes += [note] if note else []
        if width > max(columns) + 2:
            notes.append(
                f"{table.path}: columns behind the first {max(columns) + 1} are not used, as no line names them"
            )
    translations, quaternions = values[:, columns[:3]], values[:, columns[3:]]
    if times is not None:
        times, note = _in_seconds(table, times)
        notes += [note] if note else []
    return PoseTable(table.path, _from_vectors(translations, quaternions), times, None, tuple(notes))


def _from_vectors(translations: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """(N, 3) and (N, 4) x, y, z, w -> (N, 4, 4); not a number where the quaternion is not of unit length."""
    poses = np.tile(np.eye(4), (len(translations), 1, 1))
    usable = (np.abs(translations) < MAX_POSITION_M).all(axis=1) & (np.abs(_norms(quaternions) - 1) < NORM_TOLERANCE)
    poses[usable, :3, :3] = Rotation.from_quat(quaternions[usable]).as_matrix()
    poses[:, :3, 3] = translations
    poses[~usable] = np.nan
    return poses


def _norms(quaternions: np.ndarray) -> np.ndarray:
    """(N,) lengths; not a number where they are not finite."""
    with np.errstate(over="ignore"):
        norms: np.ndarray = np.linalg.norm(quaternions, axis=1)
    return norms


def _guess_columns(table: NumberTable, values: np.ndarray) -> tuple[list[int], str]:
    """Columns of tx, ty, tz, qx, qy, qz, qw, and what was assumed.

    Where the quaternion is, its unit length shows. Whether its real part is the first or the last number shows nothing
    but the format: EuRoC has it first, all others last. Raises DataError if no four numbers are of unit length.
    """
    first = 0 if values.shape[1] == 7 else 1
    finite = values[np.isfinite(values[:, : first + 7]).all(axis=1)]
    is_last, is_first = (
        bool(len(finite)) and bool((np.abs(_norms(finite[:, at : at + 4]) - 1) < NORM_TOLERANCE).mean() > 0.5)
        for at in (first + 3, first)
    )
    place = list(range(first, first + 7))
    if is_first and not is_last:
        swapped = [*place[4:], *place[1:4], place[0]]
        return (
            swapped,
            f"{table.path} is read as `qw qx qy qz tx ty tz`, because its first four numbers are of length 1",
        )
    if not is_last:
        if len(finite) == 0:
            return place, ""
        raise DataError(f"{table.path}: no four of its numbers are a unit quaternion; expected {_EXPECTED}")
    swapped = [*place[:3], *place[4:], place[3]]
    if first and values.shape[1] != 9 and np.nanmedian(values[:, 0]) > 1e17 and "," in read_text(table.path):
        return swapped, f"{table.path} is read as EuRoC, qw first: nanoseconds, separated by commas, without a header"
    if len(finite) > 1 and np.allclose(finite[0, first : first + 7], [0, 0, 0, 1, 0, 0, 0], atol=1e-6):
        return swapped, f"{table.path} is read with qw first, as it begins with 0 0 0 1 0 0 0, the identity"
    return place, ""


def _named_columns(table: NumberTable) -> list[int]:
    """Columns of tx, ty, tz, qx, qy, qz, qw if the header names them all; else empty."""
    words = [word for word in table.header if word not in _UNIT_WORDS]
    if len(words) != len(table.rows[0]):
        return []
    ends = [word.rsplit("_", 1)[-1] for word in words]
    rotates = [word.startswith(("q", "rot")) for word in words]
    columns = []
    for axis, is_rotation in [*((axis, False) for axis in "xyz"), *((axis, True) for axis in "xyzw")]:
        names = (axis, f"q{axis}", f"r{axis}") if is_rotation else (axis, f"t{axis}", f"p{axis}")
        found = [at for at, end in enumerate(ends) if end in names and rotates[at] == is_rotation]
        if not found:
            return []
        columns.append(found[0])
    return columns


def _in_seconds(table: NumberTable, times: np.ndarray) -> tuple[np.ndarray, str]:
    """Seconds of time stamps whose unit the header names or their size shows, and a note on the latter."""
    if table.header[:2] and table.header[1] in ("ns", "us", "ms"):
        return times * {"ns": 1e-9, "us": 1e-6, "ms": 1e-3}[table.header[1]], ""
    largest = np.nanmax(np.abs(times), initial=0.0, where=np.isfinite(times))
    for size, seconds, name in _UNITS_BY_SIZE:
        if largest > size:
            return times * seconds, f"time stamps of {table.path} are read as {name}"
    return times, ""


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
        poses.append(_from_vectors(row[None, 1:4], quaternion[None])[0])
    if not poses:
        raise DataError(f"{path} is a graph without poses in space (VERTEX_SE3:QUAT or VERTEX3)")
    note = f"{path}: poses of a graph are those of its vertices, matched by their ids; edges are not used"
    return PoseTable(path, np.array(poses), None, np.array(numbers), (note,))
