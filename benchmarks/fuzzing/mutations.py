"""Damage: what happens to files between a recorder and this program, and what a hostile file would try.

A mutation is four small numbers, so that it can be drawn, shrunk and written down: its kind, the file, the place in it
(as a 65536th of its length) and an argument. Where a kind does not fit a file, nothing is changed.
"""

from __future__ import annotations

import io
import json
import random
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from .samples import ENDLESS, FOLDER, LOOP, PIPE, Sample, Special

RANGE = 1 << 16  # of the numbers of a mutation
Files = dict[str, bytes | Special]
_NUMBER = re.compile(rb"[+-]?\d+\.?\d*(?:[eE][+-]?\d+)?")
_NUMBERS = (
    b"nan", b"inf", b"-inf", b"0", b"-1", b"1", b"-0.0", b"1e300", b"-1e300", b"1e-320", b"1e999", b"99999999999",
    b"4294967295", b"2147483647", b"-2147483648", b"18446744073709551616", b"65536", b"0x10", b"1,5", b"1.2.3", b"",
    b"x", b"\xd9\xa1", b"null", b"true", b"[]", b"{}", b'"a"', b"1_000", b"9" * 400, b"0.5", b"1000000", b"- 1",
)  # fmt: skip
_TOKENS = (
    b"\0", b"\xff\xff\xff\xff", b"\n", b"\r", b"\r\n", b" ", b",", b";", b'"', b"[", b"]", b"{", b"}", b"=", b"#", b"%",
    b"../", b"/", b"\\", b"-1", b"nan", b"1e300", b"99999999999", b"\xef\xbb\xbf", b"\x1b[31m", b"<script>", b"%s",
    b"\xf0\x9f\x98\x80", b"$(x)", b"\xc3(", b"\0\0\0\0", b"[" * 2000, b'{"a":' * 2000, b"A" * 5000,
)  # fmt: skip
_VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1 << 31, 1 << 63, 1 << 70, 1e300, float("nan"), float("inf"), 1e-320, "", "x", "1", "\0",
    "../..", "a\nb", "<script>alert(1)</script>", [], {}, [[]], [None], {"": 0}, [0] * 3, [1.0] * 16, "9" * 500,
)  # fmt: skip
_ENCODINGS = ("utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-8-sig", "latin-1", "cp037", "utf-7")
_NAMES = (
    "{stem}", "{stem}.txt", "{stem}_copy{suffix}", "frame{stem}{suffix}", "{stem}{suffix}.part", "x{suffix}",
    ".{stem}{suffix}", "\u0437 \u4e16{suffix}", "{stem}\n{suffix}", "<b>{stem}{suffix}", "-{stem}{suffix}",
    "{stem}{upper}", "1e5{suffix}", "99999999999999999999{suffix}", "{stem}.{stem}{suffix}", "%s{stem}{suffix}",
    "\u0661{suffix}",
)  # fmt: skip


@dataclass(frozen=True)
class Mutation:
    """One change; every number is below `RANGE`."""

    kind: str
    file: int
    place: int
    argument: int


def mutate(sample: Sample, mutations: list[Mutation], others: list[Sample]) -> Sample:
    """The sample after all `mutations`; `others` are samples whose files may take the place of its own."""
    files = dict(sample.files)
    for mutation in mutations:
        names = sorted(files)
        if not names:
            break
        name = names[mutation.file * len(names) // RANGE]
        change = KINDS[mutation.kind]
        try:
            change(files, name, mutation, others)
        except Exception:
            continue  # what an earlier mutation left is nothing that this kind can change
    return replace(sample, files=files)


# --- bytes -----------------------------------------------------------------------------------------------------------
def _bytes(change: Callable[[bytearray, int, int], object]) -> Callable[[Files, str, Mutation, list[Sample]], None]:
    """A kind that changes the content of one file: `change(data, place, argument)` works on or returns the bytes."""

    def apply(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
        content = files[name]
        if isinstance(content, Special) or not content:
            return
        data = bytearray(content)
        result = change(data, mutation.place * len(data) // RANGE, mutation.argument)
        files[name] = bytes(data if result is None else result)  # type: ignore[arg-type]

    return apply


def _early(change: Callable[[bytearray, int, int], object]) -> Callable[[bytearray, int, int], object]:
    """The same in the first 128 bytes, where headers are."""
    return lambda data, place, argument: change(data, place * min(len(data), 128) // len(data), argument)


def _flip(data: bytearray, place: int, argument: int) -> None:
    data[place] ^= 1 << argument % 8


def _set(data: bytearray, place: int, argument: int) -> None:
    data[place] = argument % 256


def _cut(data: bytearray, place: int, argument: int) -> None:
    del data[place : place + 1 + argument % 64]


def _truncate(data: bytearray, place: int, argument: int) -> None:
    del data[place:]


def _insert(data: bytearray, place: int, argument: int) -> None:
    data[place:place] = _TOKENS[argument % len(_TOKENS)]


def _repeat(data: bytearray, place: int, argument: int) -> None:
    data[place:place] = data[place : place + argument % 256] * (1 + argument % 3)


def _huge(data: bytearray, place: int, argument: int) -> None:
    values = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x10000000, 0x00FFFFFF, 0x7F800000, 0xFFC00000, 65536, 20000)
    value, order = values[argument % len(values)], "<" if argument & 0x8000 else ">"
    data[place : place + 4] = struct.pack(order + "I", value)


# --- text ------------------------------------------------------------------------------------------------------------
def _lines(data: bytearray, place: int) -> tuple[list[bytes], int]:
    lines = bytes(data).splitlines(keepends=True)
    return lines, bytes(data[:place]).count(b"\n") % len(lines)


def _drop_line(data: bytearray, place: int, argument: int) -> bytes:
    lines, at = _lines(data, place)
    del lines[at : at + 1 + argument % 3]
    return b"".join(lines)


def _double_line(data: bytearray, place: int, argument: int) -> bytes:
    lines, at = _lines(data, place)
    return b"".join(lines[:at] + [lines[at]] * (1 + argument % 4) + lines[at:])


def _swap_lines(data: bytearray, place: int, argument: int) -> bytes:
    lines, at = _lines(data, place)
    other = argument % len(lines)
    lines[at], lines[other] = lines[other], lines[at]
    return b"".join(lines)


def _shuffle_lines(data: bytearray, place: int, argument: int) -> bytes:
    lines, _ = _lines(data, place)
    random.Random(argument).shuffle(lines)
    return b"".join(lines)


def _number(data: bytearray, place: int, argument: int) -> bytes:
    match = _NUMBER.search(data, place) or _NUMBER.search(data)
    if match is None or b"\0" in data[:256]:
        return bytes(data)
    return bytes(data[: match.start()]) + _NUMBERS[argument % len(_NUMBERS)] + bytes(data[match.end() :])


def _encoding(data: bytearray, place: int, argument: int) -> bytes:
    return bytes(data).decode().encode(_ENCODINGS[argument % len(_ENCODINGS)], errors="replace")


def _line_ends(data: bytearray, place: int, argument: int) -> bytes:
    end = (b"\r\n", b"\r", b"\n\n", b" \n", b"\x0b", b"")[argument % 6]
    return bytes(data).replace(b"\n", end) if b"\0" not in data[:256] else bytes(data)


def _separator(data: bytearray, place: int, argument: int) -> bytes:
    separator = (b",", b";", b"\t", b", ", b"  ", b"|")[argument % 6]
    return bytes(data).replace(b" ", separator) if b"\0" not in data[:256] else bytes(data)


# --- structure -------------------------------------------------------------------------------------------------------
def _replace_leaf(tree: Any, place: int, value: Any, remove: bool) -> Any:
    """`tree` with the value at `place` (a 65536th of all, those of containers included) replaced, or removed."""
    spots: list[tuple[Any, Any]] = []
    pending = [tree]
    while pending:
        node = pending.pop()
        keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        for key in keys:
            spots.append((node, key))
            pending.append(node[key])
    if not spots:
        return value
    node, key = spots[place * len(spots) // RANGE]
    if remove:
        del node[key]
    else:
        node[key] = value(node[key]) if callable(value) else value
    return tree


def _json(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    content = files[name]
    if isinstance(content, Special) or content[:1] not in (b"{", b"["):
        return
    value = _VALUES[mutation.argument % len(_VALUES)]
    tree = _replace_leaf(json.loads(content), mutation.place, value, mutation.argument % 7 == 0)
    files[name] = json.dumps(tree).encode()


def _other_tensor(argument: int) -> Callable[[Any], Any]:
    """A function from a tensor to one of another size, type or content; anything else becomes another value."""

    def change(value: Any) -> Any:
        if not isinstance(value, torch.Tensor) or argument % 3 == 0:
            return _VALUES[argument // 3 % len(_VALUES)]
        choices: tuple[Callable[[torch.Tensor], Any], ...] = (
            lambda t: t[..., :0], lambda t: t.flatten(), lambda t: t[None], lambda t: t.double(), lambda t: t.bool(),
            lambda t: t.to(torch.complex64), lambda t: torch.full_like(t.double(), torch.nan), lambda t: t.long() - 1,
            lambda t: t.double() * 1e30, lambda t: t[: len(t) // 2], lambda t: t.new_zeros(1).expand(1 << 33),
            lambda t: t.to_sparse(), lambda t: torch.full_like(t, 1 << 30 if not t.is_floating_point() else 1e9),
        )  # fmt: skip
        return choices[argument // 3 % len(choices)](value)

    return change


def _tensors(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    content = files[name]
    if isinstance(content, Special) or not name.endswith(".pt"):
        return
    tree = torch.load(io.BytesIO(content), weights_only=True)
    changed = _replace_leaf(tree, mutation.place, _other_tensor(mutation.argument), mutation.argument % 7 == 0)
    buffer = io.BytesIO()
    torch.save(changed, buffer)
    files[name] = buffer.getvalue()


def _arrays(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    content = files[name]
    if isinstance(content, Special) or not name.endswith(".npz"):
        return
    arrays = dict(np.load(io.BytesIO(content)))
    key = sorted(arrays)[mutation.place * len(arrays) // RANGE]
    array = arrays.pop(key)
    choices: tuple[Callable[[np.ndarray], Any], ...] = (
        lambda a: a[..., :0], np.ravel, lambda a: a[None], lambda a: a.astype(str), lambda a: np.zeros(0),
        lambda a: a.astype(complex) if a.dtype.kind != "U" else a[None], lambda a: np.array(np.nan),
        lambda a: np.full(a.shape, -1), lambda a: np.full(a.shape, 1 << 40), lambda a: np.array(b"x"), np.array,
    )  # fmt: skip
    if mutation.argument % 7:
        arrays[key] = choices[mutation.argument % len(choices)](array)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    files[name] = buffer.getvalue()


def _inside(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    """Other bytes in an entry of a zip archive, with a right checksum; or an entry of another place or size."""
    content = files[name]
    if isinstance(content, Special) or content[:2] != b"PK":
        return
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        entries = [(info, archive.read(info)) for info in archive.infolist()]
    at = mutation.place % len(entries)
    info, data = entries[at]
    changed, kind = bytearray(data), mutation.argument % 6
    if kind == 0:
        info.filename = "../" * 3 + info.filename
    elif kind == 1 and changed:
        changed = bytearray(bytes(changed[:128]) + bytes(1 << 26))
    elif kind == 2:
        entries.append(entries[at])
    elif changed:
        spot = mutation.place * min(len(changed), 200) // RANGE
        (_flip, _set, _huge)[kind - 3](changed, spot, mutation.argument >> 4)
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED if kind == 1 else zipfile.ZIP_STORED) as archive:
        for number, (entry, original) in enumerate(entries):
            archive.writestr(entry.filename, bytes(changed) if number == at else original)
    files[name] = buffer.getvalue()


def _png(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    """Another number in the header of a PNG image (size, bits, colour type), with a right checksum."""
    content = files[name]
    if isinstance(content, Special) or not content.startswith(b"\x89PNG"):
        return
    header = bytearray(content[12:29])
    sizes = (0, 1, 7, 63, 65, 4096, 20000, 65535, 1 << 20, (1 << 31) - 1, 1 << 31)
    if mutation.place % 3 < 2:
        start = 4 + 4 * (mutation.place % 3)
        header[start : start + 4] = struct.pack(">I", sizes[mutation.argument % len(sizes)])
    else:
        header[12 + mutation.place % 5] = mutation.argument % 20
    files[name] = content[:12] + bytes(header) + struct.pack(">I", zlib.crc32(header)) + content[33:]


# --- files -----------------------------------------------------------------------------------------------------------
def _remove(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    del files[name]


def _empty(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    files[name] = b""


def _special(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    files[name] = Special((FOLDER, LOOP, PIPE, ENDLESS)[mutation.argument % 4])


def _rename(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    folder, slash, last = name.rpartition("/")
    stem, dot, suffix = last.rpartition(".")
    parts = {"stem": stem if dot else last, "suffix": dot + suffix if dot else "", "upper": (dot + suffix).upper()}
    new = folder + slash + _NAMES[mutation.argument % len(_NAMES)].format(**parts)
    files[new] = files.pop(name)


def _swap_files(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    other = sorted(files)[mutation.argument % len(files)]
    files[name], files[other] = files[other], files[name]


def _copy_file(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    other = sorted(files)[mutation.argument % len(files)]
    files[other] = files[name]


def _foreign(files: Files, name: str, mutation: Mutation, others: list[Sample]) -> None:
    """The content of a file of another sample."""
    other = others[mutation.place % len(others)]
    contents = [other.files[key] for key in sorted(other.files)]
    files[name] = contents[mutation.argument % len(contents)]


KINDS: dict[str, Callable[[Files, str, Mutation, list[Sample]], None]] = {
    "flip": _bytes(_flip), "set": _bytes(_set), "cut": _bytes(_cut), "truncate": _bytes(_truncate),
    "insert": _bytes(_insert), "repeat": _bytes(_repeat), "huge": _bytes(_huge), "flip early": _bytes(_early(_flip)),
    "huge early": _bytes(_early(_huge)), "insert early": _bytes(_early(_insert)), "cut early": _bytes(_early(_cut)),
    "drop line": _bytes(_drop_line), "double line": _bytes(_double_line), "swap lines": _bytes(_swap_lines),
    "shuffle lines": _bytes(_shuffle_lines), "number": _bytes(_number), "encoding": _bytes(_encoding),
    "line ends": _bytes(_line_ends), "separator": _bytes(_separator), "json": _json, "tensors": _tensors,
    "arrays": _arrays, "inside": _inside, "png": _png, "remove": _remove, "empty": _empty, "special": _special,
    "rename": _rename, "swap files": _swap_files, "copy file": _copy_file, "foreign": _foreign,
}  # fmt: skip


def fitting_kinds(sample: Sample) -> list[str]:
    """The kinds that can change a file of this sample."""
    names = list(sample.files)
    contents = [content for content in sample.files.values() if isinstance(content, bytes)]
    needed = {
        "json": any(content[:1] in (b"{", b"[") for content in contents),
        "tensors": any(name.endswith(".pt") for name in names),
        "arrays": any(name.endswith(".npz") for name in names),
        "inside": any(content.startswith(b"PK") for content in contents),
        "png": any(content.startswith(b"\x89PNG") for content in contents),
        "swap files": len(names) > 1,
        "copy file": len(names) > 1,
        "remove": len(names) > 1,
    }
    return [kind for kind in KINDS if needed.get(kind, True)]
