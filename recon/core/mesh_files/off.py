"""OFF files of the Object File Format (ASCII), with normals, colours and texture coordinates of vertices."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import DataError
from .number_text import parse_numbers, parse_table, plain_text
from .polygons import Polygons

MAX_COUNT = 1 << 40  # of vertices or faces; a larger number is damage
_MAGIC = re.compile(rb"(ST)?(C)?(N)?(4)?(n)?OFF\b|(?:OFF)(?=[0-9])")


def read_off(path: Path, data: bytes) -> Polygons:
    """Parse the bytes of the file `path`. Raises DataError."""
    lines = [(n, line.split(b"#")[0].strip()) for n, line in enumerate(plain_text(data).split(b"\n"), start=1)]
    lines = [(number, line) for number, line in lines if line]
    first = lines[0][1] if lines else b""
    magic = _MAGIC.match(first)
    if magic is None:
        raise DataError(f"{path} is no OFF file: it does not begin with `OFF`")
    if magic[4] or magic[5] or b"BINARY" in first:
        raise DataError(f"{path}: OFF files in binary or of another dimension are not read; save it as plain OFF")
    rest = first[magic.end() :].strip()  # some files have the counts in the same line, even without a blank
    lines = [(lines[0][0], rest), *lines[1:]] if rest else lines[1:]
    sizes = parse_numbers(lines[0][1]) if lines else None
    if sizes is None or len(sizes) not in (2, 3) or not ((sizes >= 0) & (sizes < MAX_COUNT)).all():
        raise DataError(f"{path}: its header does not name the numbers of vertices and faces")
    vertex_count, face_count = int(sizes[0]), int(sizes[1])
    rows = lines[1:]
    if len(rows) < vertex_count + face_count:
        there = f"{vertex_count} vertices and {face_count} faces"
        raise DataError(f"{path} is cut off: its header names {there}, but only {len(rows)} lines follow")
    if len(rows) > vertex_count + face_count:
        raise DataError(f"{path} holds {len(rows) - vertex_count - face_count} lines more than its header names")
    vertices, colors = _vertices(path, rows[:vertex_count], bool(magic[2]), bool(magic[3]))
    counts, corners = _faces(path, rows[vertex_count:])
    return Polygons(vertices, counts, corners, colors)


def _vertices(
    path: Path, rows: list[tuple[int, bytes]], has_colors: bool, has_normals: bool
) -> tuple[np.ndarray, np.ndarray | None]:
    if not rows:
        return np.zeros((0, 3)), None
    table = parse_table(path, [line for _, line in rows], [number for number, _ in rows])
    colors_at = 6 if has_normals else 3
    needed = colors_at + 3 * has_colors
    if table.shape[1] < needed:
        raise DataError(f"{path}, line {rows[0][0]}: a vertex has {table.shape[1]} numbers, not {needed}")
    colors = None
    if has_colors or (table.shape[1] in (6, 7) and not has_normals):
        rgb = np.nan_to_num(table[:, colors_at : colors_at + 3])
        colors = np.round(np.clip(rgb * (255 if rgb.max() <= 1 else 1), 0, 255)).astype(np.uint8)
    return table[:, :3], colors


def _faces(path: Path, rows: list[tuple[int, bytes]]) -> tuple[np.ndarray, np.ndarray]:
    counts, corners = [], []
    for number, line in rows:
        words = line.split()
        try:
            count = int(words[0])
            face = [int(word) for word in words[1 : count + 1]]  # behind them stands the colour of the face
        except ValueError:
            count, face = -1, []
        if count < 0 or len(face) != count:
            raise DataError(f"{path}, line {number}: not a face: {line.decode('latin-1')[:60]!r}")
        counts.append(count)
        corners.extend(face)
    return np.array(counts, np.int64), np.array(corners, np.int64)
