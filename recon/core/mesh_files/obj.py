"""Wavefront OBJ files: polygons, groups and objects, negative indices, colours of vertices. Materials are not read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import DataError
from .number_text import parse_table, plain_text, separated
from .polygons import Polygons

# What describes neither the surface nor its colours of vertices.
_IGNORED = {
    b"vn", b"vt", b"g", b"o", b"s", b"mg", b"usemtl", b"mtllib", b"usemap", b"maplib", b"bevel", b"c_interp",
    b"d_interp", b"lod", b"shadow_obj", b"trace_obj",
}  # fmt: skip
_FREE_FORM = {b"vp", b"cstype", b"deg", b"bmat", b"step", b"curv", b"curv2", b"surf", b"con", b"call", b"csh"}
_COLUMNS = {3: "x y z", 4: "x y z w", 6: "x y z r g b", 7: "x y z r g b a"}


def read_obj(path: Path, data: bytes) -> Polygons:
    """Parse the bytes of the file `path`. Raises DataError."""
    text = plain_text(data)
    if b"\\\n" in text:
        text = text.replace(b"\\\n", b" ")
    vertex_lines: list[bytes] = []
    vertex_numbers: list[int] = []
    counts: list[int] = []
    corners: list[int] = []
    left_out: dict[str, int] = {}
    for number, line in enumerate(text.split(b"\n"), start=1):
        word, _, rest = (
            line.strip().partition(b" ") if b"\t" not in line else line.strip().replace(b"\t", b" ").partition(b" ")
        )
        if word == b"v":
            vertex_lines.append(rest.split(b"#")[0].strip())
            vertex_numbers.append(number)
        elif word == b"f":
            face = _face_corners(path, number, rest.split(b"#")[0], len(vertex_lines))
            counts.append(len(face))
            corners.extend(face)
        elif word in (b"l", b"p"):
            kind = "lines" if word == b"l" else "points"
            left_out[kind] = left_out.get(kind, 0) + 1
        elif word in _FREE_FORM:
            raise DataError(
                f"{path}, line {number}: free-form curves and surfaces are not read; export polygons instead"
            )
        elif word and not word.startswith(b"#") and word not in _IGNORED:
            shown = line.decode("latin-1").strip()[:60]
            raise DataError(f"{path}, line {number}: not a statement of an OBJ file: {shown!r}")
    if not vertex_lines:
        raise DataError(f"{path} holds no vertices (lines `v x y z`): not an OBJ file, or an empty one")
    vertices, colors = _vertices(path, vertex_lines, vertex_numbers)
    notes = tuple(f"{count} statements of {kind} are left out" for kind, count in left_out.items())
    return Polygons(vertices, np.array(counts, np.int64), np.array(corners, np.int64), colors, None, 1, notes=notes)


def _face_corners(path: Path, number: int, text: bytes, vertices: int) -> list[int]:
    """Vertices of the corners `v`, `v/vt`, `v//vn` or `v/vt/vn`, from 0; negative ones count from the last one back."""
    try:
        indices = [int(word.partition(b"/")[0]) for word in text.split()]
    except ValueError:
        indices = [0]
    if 0 in indices or not indices:
        shown = text.decode("latin-1").strip()[:60]
        raise DataError(f"{path}, line {number}: not the corners of a face: {shown!r}")
    face = [index - 1 if index > 0 else vertices + index for index in indices]
    if min(face) < 0:
        raise DataError(
            f"{path}, line {number}: a face names vertex {min(indices)}, but only {vertices} stand before it"
        )
    return face


def _vertices(path: Path, lines: list[bytes], numbers: list[int]) -> tuple[np.ndarray, np.ndarray | None]:
    """(V, 3) positions, and (V, 3) uint8 colours if every vertex has one."""
    lines = list(separated(path, lines))
    widths = np.array([len(line.split()) for line in lines])
    kinds = np.unique(widths)
    if not set(kinds.tolist()) <= set(_COLUMNS):
        bad = int(np.flatnonzero(~np.isin(widths, list(_COLUMNS)))[0])
        shown = lines[bad].decode("latin-1")[:60]
        raise DataError(f"{path}, line {numbers[bad]}: expected one of {', '.join(_COLUMNS.values())}, found {shown!r}")
    vertices, colors = np.zeros((len(lines), 3)), np.zeros((len(lines), 3))
    for width in kinds:
        rows = np.flatnonzero(widths == width)
        table = parse_table(path, [lines[row] for row in rows], [numbers[row] for row in rows], int(width))
        vertices[rows] = table[:, :3]
        if width >= 6:
            colors[rows] = table[:, 3:6]
    if kinds.min() < 6:
        return vertices, None
    scale = 255.0 if colors.max() <= 1 else 1.0
    return vertices, np.round(np.clip(np.nan_to_num(colors) * scale, 0, 255)).astype(np.uint8)
