"""PLY files: ASCII and binary of both byte orders, any properties and list types, polygons and triangle strips."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import DataError
from .number_text import parse_numbers
from .polygons import Polygons, pack, strip_triangles

_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "long": "i8", "int64": "i8",
    "ulong": "u8", "uint64": "u8", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
# Letters of the module `struct`.
_LETTERS = {
    "i1": "b",
    "u1": "B",
    "i2": "h",
    "u2": "H",
    "i4": "i",
    "u4": "I",
    "i8": "q",
    "u8": "Q",
    "f4": "f",
    "f8": "d",
}
_FACE_LISTS = ("vertex_indices", "vertex_index")
_COLORS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_HEADER_END = re.compile(rb"^end_header[ \t]*(\r\n|\n|\r)", re.MULTILINE)


@dataclass(frozen=True)
class _Property:
    """`counted_by`: type of the number of items of a list; None for a single value."""

    name: str
    kind: str
    counted_by: str | None


@dataclass(frozen=True)
class _Element:
    name: str
    rows: int
    properties: tuple[_Property, ...]


@dataclass(frozen=True)
class _Lists:
    """counts (R,) int64 items of each row; items (sum of counts,)."""

    counts: np.ndarray
    items: np.ndarray


_Columns = dict[str, np.ndarray | _Lists]


class _Body(Protocol):
    """The values behind the header; places count bytes (binary) or numbers (ASCII)."""

    @property
    def end(self) -> int: ...

    def size(self, kind: str) -> int:
        """Length of one value."""

    def reader(self, kind: str) -> Callable[[int], float]:
        """A function that returns the value at a place."""

    def strided(self, place: int, stride: int, rows: int, items: int, kind: str) -> np.ndarray:
        """(rows, items) values from `place` on, `stride` from row to row."""

    def gathered(self, places: np.ndarray, items: int, kind: str) -> np.ndarray:
        """(len(places), items) values from each of `places` on."""


@dataclass(frozen=True)
class _Binary:
    data: bytes
    order: str  # "<" or ">"

    @property
    def end(self) -> int:
        return len(self.data)

    def size(self, kind: str) -> int:
        return int(kind[1])

    def reader(self, kind: str) -> Callable[[int], float]:
        unpack, data = struct.Struct(self.order + _LETTERS[kind]).unpack_from, self.data
        return lambda place: unpack(data, place)[0]

    def strided(self, place: int, stride: int, rows: int, items: int, kind: str) -> np.ndarray:
        dtype = np.dtype(self.order + kind)
        return np.ndarray((rows, items), dtype, self.data, place, (stride, dtype.itemsize))

    def gathered(self, places: np.ndarray, items: int, kind: str) -> np.ndarray:
        span = items * self.size(kind)
        raw = np.frombuffer(self.data, np.uint8)[places[:, None] + np.arange(span)]
        return np.ascontiguousarray(raw).view(self.order + kind).reshape(len(places), items)


@dataclass(frozen=True)
class _Ascii:
    values: np.ndarray

    @property
    def end(self) -> int:
        return len(self.values)

    def size(self, kind: str) -> int:
        return 1

    def reader(self, kind: str) -> Callable[[int], float]:
        return self.values.item

    def strided(self, place: int, stride: int, rows: int, items: int, kind: str) -> np.ndarray:
        step = self.values.itemsize
        return np.ndarray((rows, items), float, self.values.data, place * step, (stride * step, step))

    def gathered(self, places: np.ndarray, items: int, kind: str) -> np.ndarray:
        return self.values[places[:, None] + np.arange(items)]


def read_ply(path: Path, data: bytes) -> Polygons:
    """Parse the bytes of the file `path`. Raises DataError."""
    if not data[:4].split() == [b"ply"]:
        raise DataError(f"{path} is no PLY file: it does not begin with `ply`")
    end = _HEADER_END.search(data)
    if end is None:
        raise DataError(f"{path} is cut off: its header has no end")
    form, elements = _parse_header(path, data[: end.start()])
    body = _make_body(path, form, data[end.end() :], data[: end.end()].count(b"\n"))
    tables: dict[str, _Columns] = {}
    place = 0
    for element in elements:
        tables[element.name], place = _read_element(path, element, body, place)
    rest = body.end - place
    notes = []
    if rest and form == "ascii":
        raise DataError(f"{path} holds {rest} numbers more than its header names; the file is damaged")
    if rest:
        notes.append(f"{rest} bytes behind the last element are left out")
    known = ("vertex", "face", "tristrips")
    notes += [f"element `{e.name}` ({e.rows} rows) is left out" for e in elements if e.name not in known and e.rows]
    counts, corners = pack([])
    if "face" in tables:
        faces = _face_lists(path, tables["face"], _rows(elements, "face"))
        counts, corners = faces.counts, _as_indices(path, faces.items)
    if "tristrips" in tables:
        strips = _only_list(path, "tristrips", tables["tristrips"])
        blocks = _strip_blocks(strips.counts, _as_indices(path, strips.items))
        counts, corners = np.append(counts, blocks[0]), np.append(corners, blocks[1])
    kinds = _kinds(elements)
    vertices, colors, sigma = _vertex_values(path, tables.get("vertex", {}), kinds)
    is_single = form != "ascii" and "f4" in (kinds[axis] for axis in "xyz")
    return Polygons(vertices, counts, corners, colors, sigma, is_single=is_single, notes=tuple(notes))


def _parse_header(path: Path, header: bytes) -> tuple[str, list[_Element]]:
    form = ""
    elements: list[_Element] = []
    for line in re.split(r"[\r\n]+", header.decode("latin-1"))[1:]:
        words = line.split()
        try:
            match words:
                case [] | ["comment" | "obj_info", *_]:
                    pass
                case ["format", "ascii" | "binary_little_endian" | "binary_big_endian" as form, _]:
                    pass
                case ["element", name, rows] if int(rows) >= 0:
                    elements.append(_Element(name, int(rows), ()))
                case ["property", "list", count_kind, kind, name]:
                    counted = _TYPES[count_kind]
                    elements[-1] = _with(elements[-1], _Property(name, _TYPES[kind], counted))
                case ["property", kind, name]:
                    elements[-1] = _with(elements[-1], _Property(name, _TYPES[kind], None))
                case _:
                    raise ValueError(line)
        except (ValueError, KeyError, IndexError) as error:
            raise DataError(f"{path}: its header has a line that is not PLY: {line.strip()[:60]!r}") from error
    if not form:
        raise DataError(f"{path}: its header names no known format (ascii, binary_little_endian, binary_big_endian)")
    return form, elements


def _with(element: _Element, added: _Property) -> _Element:
    return _Element(element.name, element.rows, (*element.properties, added))


def _make_body(path: Path, form: str, data: bytes, header_lines: int) -> _Body:
    if form != "ascii":
        return _Binary(data, "<" if form == "binary_little_endian" else ">")
    values = parse_numbers(data)
    if values is None:
        lines = data.splitlines()
        bad = next(i for i, line in enumerate(lines) if parse_numbers(line) is None)
        shown = lines[bad].decode("latin-1").strip()[:60]
        raise DataError(f"{path}, line {header_lines + bad + 1}: expected numbers, found {shown!r}")
    return _Ascii(values)


def _read_element(path: Path, element: _Element, body: _Body, place: int) -> tuple[_Columns, int]:
    """The values of all rows by property, and the place behind them."""
    if element.rows == 0 or not element.properties:
        return {p.name: _Lists(*pack([])) if p.counted_by else np.zeros(0) for p in element.properties}, place
    lengths = _row_lengths(path, element, body, place)
    offsets, stride = _offsets(element, body, lengths)
    if place + stride * element.rows <= body.end and _all_alike(element, body, place, offsets, stride, lengths):
        columns = _uniform_columns(element, body, place, offsets, stride, lengths)
        return columns, place + stride * element.rows
    return _ragged_columns(path, element, body, place)


def _row_lengths(path: Path, element: _Element, body: _Body, place: int) -> list[int]:
    """The number of items of each list of the first row; 1 for a single value."""
    lengths = []
    for item in element.properties:
        length = 1
        if item.counted_by is not None:
            if place + body.size(item.counted_by) > body.end:
                raise _cut_off(path, element, 0)
            length = _list_length(path, element, float(body.strided(place, 1, 1, 1, item.counted_by)[0, 0]))
            place += body.size(item.counted_by)
        place += length * body.size(item.kind)
        lengths.append(length)
    if place > body.end:
        raise _cut_off(path, element, 0)
    return lengths


def _offsets(element: _Element, body: _Body, lengths: Sequence[int]) -> tuple[list[int], int]:
    """Place of each property within a row (of a list: of its number of items), and the length of the row."""
    offsets, place = [], 0
    for item, length in zip(element.properties, lengths, strict=True):
        offsets.append(place)
        place += length * body.size(item.kind) + (body.size(item.counted_by) if item.counted_by else 0)
    return offsets, place


def _all_alike(
    element: _Element, body: _Body, place: int, offsets: list[int], stride: int, lengths: list[int]
) -> bool:  # fmt: skip
    """Whether every row has lists as long as those of the first."""
    return all(
        item.counted_by is None
        or bool((body.strided(place + offset, stride, element.rows, 1, item.counted_by) == length).all())
        for item, offset, length in zip(element.properties, offsets, lengths, strict=True)
    )


def _uniform_columns(
    element: _Element, body: _Body, place: int, offsets: list[int], stride: int, lengths: list[int]
) -> _Columns:  # fmt: skip
    columns: _Columns = {}
    for item, offset, length in zip(element.properties, offsets, lengths, strict=True):
        start = place + offset + (body.size(item.counted_by) if item.counted_by else 0)
        values = body.strided(start, stride, element.rows, length, item.kind)
        if item.counted_by is None:
            columns[item.name] = values[:, 0]
        else:
            columns[item.name] = _Lists(np.full(element.rows, length, np.int64), values.reshape(-1))
    return columns


def _ragged_columns(path: Path, element: _Element, body: _Body, place: int) -> tuple[_Columns, int]:
    """Row by row, because the place of a row depends on the lists of all rows before."""
    size = len(element.properties)
    if element.rows * sum(body.size(p.counted_by or p.kind) for p in element.properties) > body.end - place:
        raise _cut_off(path, element, None)
    starts, counts = np.zeros((element.rows, size), np.int64), np.ones((element.rows, size), np.int64)
    readers = {p.counted_by: body.reader(p.counted_by) for p in element.properties if p.counted_by}
    for row in range(element.rows):
        for column, item in enumerate(element.properties):
            length = 1
            if item.counted_by is not None:
                if place + body.size(item.counted_by) > body.end:
                    raise _cut_off(path, element, row)
                length = _list_length(path, element, readers[item.counted_by](place))
                place += body.size(item.counted_by)
            starts[row, column], counts[row, column] = place, length
            place += length * body.size(item.kind)
        if place > body.end:
            raise _cut_off(path, element, row)
    columns: _Columns = {}
    for column, item in enumerate(element.properties):
        if item.counted_by is None:
            columns[item.name] = body.gathered(starts[:, column], 1, item.kind)[:, 0]
            continue
        lengths = counts[:, column]
        places = np.cumsum(lengths) - lengths
        items = np.zeros(int(lengths.sum()), dtype=float if isinstance(body, _Ascii) else item.kind)
        for length in np.unique(lengths[lengths > 0]):
            rows = np.flatnonzero(lengths == length)
            items[places[rows][:, None] + np.arange(length)] = body.gathered(starts[rows, column], length, item.kind)
        columns[item.name] = _Lists(lengths, items)
    return columns, place


def _list_length(path: Path, element: _Element, length: float) -> int:
    if not (length >= 0 and length == int(length)):
        raise DataError(f"{path}: a list of element `{element.name}` has {length:g} items; the file is damaged")
    return int(length)


def _cut_off(path: Path, element: _Element, row: int | None) -> DataError:
    where = "" if row is None else f", but the file ends in row {row + 1}"
    return DataError(f"{path} is cut off: element `{element.name}` has {element.rows} rows by its header{where}")


def _kinds(elements: Sequence[_Element]) -> dict[str, str]:
    """Property of the vertices -> type."""
    return {p.name: p.kind for e in elements if e.name == "vertex" for p in e.properties}


def _rows(elements: Sequence[_Element], name: str) -> int:
    return next(e.rows for e in elements if e.name == name)


def _face_lists(path: Path, face: _Columns, rows: int) -> _Lists:
    for name in _FACE_LISTS:
        lists = face.get(name)
        if isinstance(lists, _Lists):
            return lists
    if rows == 0:
        return _Lists(*pack([]))
    return _only_list(path, "face", face)


def _only_list(path: Path, element: str, columns: _Columns) -> _Lists:
    lists = [values for values in columns.values() if isinstance(values, _Lists)]
    if len(lists) != 1:
        names = ", ".join(columns) or "nothing"
        raise DataError(f"{path}: element `{element}` has no list `vertex_indices`, but {names}")
    return lists[0]


def _as_indices(path: Path, items: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        indices = items.astype(np.int64)
    if not (indices == items).all():
        raise DataError(f"{path}: a face names a vertex by a number that is not whole; the file is damaged")
    return indices


def _strip_blocks(counts: np.ndarray, items: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of strips that end at -1 and at the end of each list."""
    ends = np.cumsum(counts)
    breaks = np.concatenate([np.flatnonzero(items == -1), ends - 1])
    pieces = np.split(items, np.unique(breaks) + 1)
    strips = [piece[piece != -1] for piece in pieces]
    return pack([strip_triangles(strip) for strip in strips if len(strip) >= 3])


def _vertex_values(
    path: Path, vertex: _Columns, kinds: dict[str, str]
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
    values = {name: column for name, column in vertex.items() if isinstance(column, np.ndarray)}
    if not all(axis in values for axis in "xyz"):
        there = f"but {', '.join(vertex)}" if vertex else "or no vertices at all"
        raise DataError(f"{path}: element `vertex` has no x, y and z, {there}")
    with np.errstate(invalid="ignore"):  # signalling NaNs
        vertices = np.stack([values[axis].astype(float) for axis in "xyz"], axis=1)
    colors = None
    for names in _COLORS:
        if all(name in values for name in names):
            colors = _as_bytes(np.stack([values[name] for name in names], axis=1), kinds[names[0]])
            break
    sigma = values["sigma"].astype(np.float32) if "sigma" in values else None
    return vertices, colors, sigma


def _as_bytes(colors: np.ndarray, kind: str) -> np.ndarray:
    """(V, 3) colours of a type as uint8. Real numbers reach from 0 to 1, those of 16 bits to 65535, if they do."""
    if colors.dtype == np.uint8 or len(colors) == 0:
        return colors.astype(np.uint8)
    values = np.nan_to_num(colors.astype(float), posinf=0, neginf=0)
    largest, scale = values.max(), 1.0
    if kind in ("f4", "f8") and largest <= 1:
        scale = 255.0
    elif largest > 255:
        scale = 255 / 65535
    converted: np.ndarray = np.round(np.clip(values * scale, 0, 255)).astype(np.uint8)
    return converted
