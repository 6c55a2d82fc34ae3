"""Text files of any usual encoding, and tables of numbers in them: separators, decimal commas, exponents, comments.

What can be meant in one way only is read; anything else is an error that names the file and the line.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .errors import DataError
from .files import read_bytes

_MARKS = (  # UTF-32 first: its mark begins with that of UTF-16
    (b"\xff\xfe\x00\x00", "utf-32"),
    (b"\x00\x00\xfe\xff", "utf-32"),
    (b"\xef\xbb\xbf", "utf-8-sig"),
    (b"\xff\xfe", "utf-16"),
    (b"\xfe\xff", "utf-16"),
)
_LINE_END = re.compile(r"\r\n|\r|\n")
_COMMENTS = ("#", "%", "//")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdDqQ][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(
    r"[+-]?(?:(inf(?:inity)?|1\.#inf\w*)|nan(?:\(\w*\))?|1\.#\w+|\*{2,})", re.ASCII | re.IGNORECASE
)
_DECIMAL_COMMA = re.compile(r"\d,\d", re.ASCII)
_BRACKETS = str.maketrans(dict.fromkeys("[]{}", " ") | {"\u2212": "-", "\ufeff": ""})
_TRAILING_COMMENT = re.compile(r"\s#.*")
_MAX_SHOWN = 60  # characters of a bad line in a message


@dataclass(frozen=True)
class TextLine:
    """A line that is neither blank nor a comment; `number` counts from 1."""

    number: int
    text: str


@dataclass(frozen=True)
class NumberTable:
    """Rows of numbers of one file.

    rows     the numbers of each line; not a number and infinity are kept as such
    lines    number of each line in the file, from 1
    names    first word of each line where it is no number (the name of an image, say); empty if lines have none
    header   words of the line that names the columns, in lower case; empty if there is none
    """

    path: Path
    rows: tuple[tuple[float, ...], ...]
    lines: tuple[int, ...]
    names: tuple[str, ...] = ()
    header: tuple[str, ...] = ()


def read_text(path: Path) -> str:
    """The text of a file in UTF-8, UTF-16, UTF-32 or Latin-1, without byte order mark. Raises DataError."""
    try:
        data = read_bytes(path)
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}") from error
    try:
        text = data.decode(_encoding(data))
    except UnicodeDecodeError as error:
        raise DataError(f"cannot read {path}: it is damaged or no text ({error.reason})") from error
    control = sum(character < " " and character not in "\t\r\n\f\v\x1a" for character in text[:4096])
    if control > len(text[:4096]) // 20:
        raise DataError(f"cannot read {path}: it is a binary file, not text")
    return text.removeprefix("\ufeff").rstrip("\x1a")


def marked_encoding(data: bytes) -> str | None:
    """The encoding that a byte order mark states; None without one."""
    return next((encoding for mark, encoding in _MARKS if data.startswith(mark)), None)


def _encoding(data: bytes) -> str:
    marked = marked_encoding(data)
    if marked is not None:
        return marked
    if b"\0" in data[:4096]:  # numbers and Latin letters in UTF-16: every second byte is zero
        return "utf-16-be" if data[:4096:2].count(0) > data[1:4096:2].count(0) else "utf-16-le"
    try:
        data.decode()
    except UnicodeDecodeError:
        return "latin-1"
    return "utf-8"


def text_lines(path: Path) -> list[TextLine]:
    """The lines of a file without blank ones and comments (`#`, `%`, `//`). Raises DataError."""
    return _content(_all_lines(path))


def _all_lines(path: Path) -> list[TextLine]:
    numbered = enumerate(_LINE_END.split(read_text(path)), start=1)
    return [TextLine(number, text.replace("\ufeff", "").strip()) for number, text in numbered]


def _content(lines: Sequence[TextLine]) -> list[TextLine]:
    return [line for line in lines if line.text and not line.text.startswith(_COMMENTS)]


def parse_number(word: str) -> float | None:
    """The number that `word` states, Fortran's exponents and all spellings of infinity included; None if it is none."""
    if _NUMBER.fullmatch(word):
        return float(re.sub("[dDqQ]", "e", word))
    if match := _NOT_FINITE.fullmatch(word):
        return float("-inf" if word[0] == "-" else "inf") if match[1] else float("nan")
    return None


def read_table(path: Path, fits: Callable[[Sequence[int]], bool], expected: str) -> NumberTable:
    """The numbers of a text file.

    `fits` tells from the count of numbers in each line whether the table can be what is wanted, which `expected`
    states for messages. White space, commas, semicolons and vertical bars separate; commas are decimal points where
    only that fits. Raises DataError naming the file and, where there is one, the first bad line.
    """
    everything = _all_lines(path)
    lines = [TextLine(line.number, _TRAILING_COMMENT.sub("", line.text)) for line in _content(everything)]
    header = _header(everything, lines)
    if lines and header and not _has_number(lines[0].text):
        lines = lines[1:]
    if not lines:
        raise DataError(f"{path} holds no numbers; expected {expected}")
    kinds = (False, True) if any(_DECIMAL_COMMA.search(line.text) for line in lines) else (False,)
    readings = [_Reading.of(lines, decimal_comma) for decimal_comma in kinds]
    usable = [reading for reading in readings if reading.is_numeric and fits([len(row) for row in reading.rows])]
    if len(usable) == 2:
        raise DataError(f"{path}: its commas may separate numbers or stand for decimal points; use one separator")
    if usable:
        numbers = tuple(line.number for line in lines)
        return NumberTable(path, usable[0].rows, numbers, usable[0].names, header)
    raise _bad_line(path, lines, readings, expected)


@dataclass(frozen=True)
class _Reading:
    """Lines as numbers, if commas are decimal points or if they separate."""

    rows: tuple[tuple[float, ...], ...]
    names: tuple[str, ...]
    bad: tuple[int, ...]  # positions of lines with something else than numbers

    @property
    def is_numeric(self) -> bool:
        return not self.bad

    @staticmethod
    def of(lines: Sequence[TextLine], decimal_comma: bool) -> _Reading:
        words = [_words(line.text, decimal_comma) for line in lines]
        names: tuple[str, ...] = ()
        if all(
            len(line) > 1 and line[0] and line[0][0] not in "+-." and parse_number(line[0]) is None for line in words
        ):
            names, words = tuple(line[0] for line in words), [line[1:] for line in words]
        values = [[parse_number(word) for word in line] for line in words]
        bad = tuple(index for index, row in enumerate(values) if None in row)
        return _Reading(tuple(tuple(v for v in row if v is not None) for row in values), names, bad)


def _words(text: str, decimal_comma: bool) -> list[str]:
    text = text.translate(_BRACKETS)
    if not decimal_comma:
        return [word.strip("\"'") for word in re.split(r"[\s,;|]+", text) if word]
    words = [word.rstrip(",").strip("\"'") for word in re.split(r"[\s;|]+", text) if word]
    return [
        word.replace(",", ".") if "." not in word and _DECIMAL_COMMA.search(word) else word for word in words if word
    ]


def _has_number(text: str) -> bool:
    return any(parse_number(word) is not None for word in _words(text, decimal_comma=False))


def _header(everything: Sequence[TextLine], lines: Sequence[TextLine]) -> tuple[str, ...]:
    """Words of the last line before the first numbers, if it names at least two columns; comment signs are cut."""
    first = next((line.number for line in lines if _has_number(line.text)), 1)
    heads = [line.text.lstrip("#%/ ") for line in everything[: first - 1]]
    words = re.findall(r"[a-z_]\w*", next((head for head in reversed(heads) if head), "").lower())
    return tuple(words) if len(words) > 1 else ()


def _bad_line(path: Path, lines: Sequence[TextLine], readings: Sequence[_Reading], expected: str) -> DataError:
    """The error that names the first line that is not like the others."""
    plain = readings[0]
    if plain.bad:
        index = plain.bad[0]
        word = next(w for w in _words(lines[index].text, False) if parse_number(w) is None)
        return DataError(f"{path}, line {lines[index].number}: {word[:_MAX_SHOWN]!r} is no number; expected {expected}")
    widths = [len(row) for row in plain.rows]
    usual = max(widths, key=widths.count)  # the first of several
    index = next((index for index, width in enumerate(widths) if width != usual), 0)
    line, count = lines[index], widths[index]
    comma = " (a comma may separate numbers or be a decimal point)" if _DECIMAL_COMMA.search(line.text) else ""
    shown = line.text.strip()[:_MAX_SHOWN]
    return DataError(f"{path}, line {line.number}: expected {expected}, found {count} numbers{comma}: {shown!r}")
