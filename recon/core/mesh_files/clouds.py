"""Point clouds: PCD files, and text with a point in each line (XYZ, PTS, CSV)."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import DataError
from .number_text import parse_numbers, parse_table, plain_text, separated
from .polygons import Polygons, pack

_PCD_TYPES = {"F": "f", "I": "i", "U": "u"}
_PCD_DATA = re.compile(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", re.MULTILINE)
_NO_FACES = pack([])
_UNMOVED = [0, 0, 0, 1, 0, 0, 0]


def read_pcd(path: Path, data: bytes) -> Polygons:
    """Parse the bytes of the file `path`. Raises DataError."""
    start = _PCD_DATA.search(data[:10_000])
    if start is None or not re.search(rb"^FIELDS\b", data[: start.start()], re.MULTILINE):
        raise DataError(f"{path} is no PCD file: its header has no lines FIELDS and DATA")
    lines = data[: start.start()].decode("latin-1").splitlines()
    header = {words[0]: words[1:] for line in lines if (words := line.split())}
    try:
        names = header["FIELDS"]
        repeats = [int(n) for n in header.get("COUNT", ["1"] * len(names))]
        kinds = [f"<{_PCD_TYPES[t]}{int(n)}" for t, n in zip(header["TYPE"], header["SIZE"], strict=True)]
        points = int(header["POINTS"][0]) if "POINTS" in header else int(header["WIDTH"][0]) * int(header["HEIGHT"][0])
        viewpoint = [float(word) for word in header.get("VIEWPOINT", [])]
        row = np.dtype([(f"{i}", kind, (n,)) for i, (kind, n) in enumerate(zip(kinds, repeats, strict=True))])
        axes = [names.index(axis) for axis in "xyz"]
        if len(names) != len(kinds) or points < 0:
            raise ValueError(f"{len(names)} fields of {len(kinds)} types, {points} points")
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise DataError(f"{path}: its header is no header of a PCD file with x, y and z ({error})") from error
    notes = ("its VIEWPOINT is not applied",) if viewpoint not in ([], _UNMOVED) else ()
    body, form = data[start.end() :], start[1]
    if form == b"ascii":
        values = parse_numbers(body)
        columns = sum(repeats)
        if values is None or len(values) != points * columns:
            found = "words" if values is None else f"{len(values)} numbers"
            raise DataError(f"{path}: {points} points of {columns} numbers by its header, but {found} follow")
        firsts = np.cumsum(repeats) - repeats
        vertices = values.reshape(points, columns)[:, firsts[axes]]
    elif form == b"binary":
        if len(body) < points * row.itemsize:
            there = f"{points} points take {points * row.itemsize} bytes, but {len(body)} follow"
            raise DataError(f"{path} is cut off: {there}")
        table = np.frombuffer(body, row, points)
        with np.errstate(invalid="ignore"):  # signalling NaNs
            vertices = np.stack([table[f"{axis}"][:, 0].astype(float) for axis in axes], axis=1)
    elif form == b"binary_compressed":
        vertices = _compressed_points(path, points)
    else:
        raise DataError(f"{path}: DATA {form.decode()} is not read; save it as ascii or binary")
    is_single = form != b"ascii" and "<f4" in (kinds[axis] for axis in axes)
    return Polygons(vertices, *_NO_FACES, is_single=is_single, notes=notes)


def read_points(path: Path, data: bytes) -> Polygons:
    """Parse text with x, y, z and other numbers (intensity, colour, normal) in each line. Raises DataError.

    In a PTS file the first line is the number of points; other files may begin with the names of the columns.
    """
    lines = [(n, line.strip()) for n, line in enumerate(plain_text(data).split(b"\n"), start=1)]
    lines = [(n, line) for n, line in lines if line and not line.startswith((b"#", b"//"))]
    notes: tuple[str, ...] = ()
    if lines and parse_numbers(lines[0][1].replace(b",", b" ").replace(b";", b" ")) is None:
        names = lines[0][1].decode("latin-1")[:60]
        if not re.match(r"[\"' ]*x[\"']?[\s,;]+[\"']?y[\"']?[\s,;]+[\"']?z", names, re.IGNORECASE):
            raise DataError(f"{path}, line {lines[0][0]}: expected a point `x y z`, found {names!r}")
        lines = lines[1:]
    if lines and len(lines[0][1].split()) == 1 and lines[0][1].isdigit():
        promised = int(lines[0][1])
        lines = lines[1:]
        if promised != len(lines):
            raise DataError(f"{path} is cut off or damaged: it announces {promised} points and holds {len(lines)}")
    if not lines:
        raise DataError(f"{path} holds no points")
    numbers, rows = [number for number, _ in lines], list(separated(path, [line for _, line in lines]))
    table = parse_table(path, rows, numbers)
    if table.shape[1] < 3:
        raise DataError(f"{path}, line {numbers[0]}: expected a point `x y z`, found {rows[0].decode('latin-1')!r}")
    return Polygons(table[:, :3], *_NO_FACES, notes=notes)


def _compressed_points(path: Path, points: int) -> np.ndarray:
    import open3d as o3d  # slow to import; it has the decoder

    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(str(path), format="pcd", remove_nan_points=False, remove_infinite_points=False)
    vertices = np.asarray(cloud.points)
    if len(vertices) != points:
        raise DataError(f"{path} is cut off: {points} points by its header, but {len(vertices)} can be read")
    return vertices
