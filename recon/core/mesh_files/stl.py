"""STL files, binary and ASCII. Corners in the same place become one vertex."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import DataError
from .number_text import parse_table, plain_text
from .polygons import Polygons, pack

_HEADER, _FACET = 84, 50  # bytes
_STATEMENT = re.compile(rb"^[ \t]*(vertex|facet|endfacet|endsolid|solid)\b[ \t]*([^\n]*)", re.MULTILINE | re.IGNORECASE)


def read_stl(path: Path, data: bytes) -> Polygons:
    """Parse the bytes of the file `path`. Raises DataError."""
    promised = int.from_bytes(data[80:_HEADER], "little") if len(data) >= _HEADER else -1
    if promised >= 0 and len(data) == _HEADER + _FACET * promised:
        return _welded(_binary_corners(data, promised))
    text = plain_text(data)
    if text.lstrip()[:5].lower() == b"solid" and b"\0" not in text[:1000]:
        return _welded(_ascii_corners(path, text))
    if promised < 0 or promised > 1_000_000_000:
        raise DataError(f"{path} is no STL file: it neither begins with `solid` nor has a binary header")
    expected = _HEADER + _FACET * promised
    if len(data) < expected:
        raise DataError(f"{path} is cut off: {promised} triangles take {expected} bytes, but it has {len(data)}")
    note = f"{len(data) - expected} bytes behind the last triangle are left out"
    return _welded(_binary_corners(data, promised), (note,))


def _binary_corners(data: bytes, count: int) -> np.ndarray:
    """(count, 3, 3) float32."""
    facet = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    return np.frombuffer(data, facet, count, _HEADER)["corners"]


def _ascii_corners(path: Path, text: bytes) -> np.ndarray:
    statements = _STATEMENT.findall(text)
    words = [word.lower() for word, _ in statements]
    if words.count(b"endsolid") < words.count(b"solid") or words.count(b"facet") != words.count(b"endfacet"):
        raise DataError(f"{path} is cut off: a `solid` or a `facet` has no end")
    lines = [rest for word, rest in statements if word.lower() == b"vertex"]
    per_facet = np.diff(np.flatnonzero(np.isin(words, [b"facet", b"endfacet"])))[::2] - 1
    if (per_facet != 3).any():
        bad = int(np.flatnonzero(per_facet != 3)[0])
        raise DataError(f"{path}: facet {bad + 1} has {per_facet[bad]} corners, not three; the file is damaged")
    numbers = [i for i, line in enumerate(text.split(b"\n"), start=1) if line.strip()[:6].lower() == b"vertex"]
    return parse_table(path, lines, numbers, 3).reshape(-1, 3, 3)


def _welded(corners: np.ndarray, notes: tuple[str, ...] = ()) -> Polygons:
    """Corners (T, 3, 3) in the precision of the file: in map coordinates float32 would join and move those of text."""
    vertices, places = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
    is_single = corners.dtype == np.float32
    return Polygons(vertices.astype(float), *pack([places.reshape(-1, 3)]), is_single=is_single, notes=notes)
