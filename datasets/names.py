"""Order and association of files by their names and by the numbers in them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from decimal import Decimal
from typing import TypeVar

_DECIMAL, _WHOLE = r"\d+(?:\.\d+)?", r"\d+"

T = TypeVar("T")


def natural_key(name: str, number: str = _DECIMAL) -> tuple[tuple[Decimal, str], ...]:
    """Sort key by which `frame2` precedes `frame10`, and `1.25` precedes `1.5` precedes `10.25`."""
    parts = re.findall(rf"{number}|\D+|\d", name, re.ASCII)
    return tuple((Decimal(part), "") if "0" <= part[0] <= "9" else (Decimal(-1), part) for part in parts)


def sorted_names(names: Iterable[str]) -> list[str]:
    """`names` in natural order; where `1.1` and `1.10` are two of them, the digits after the point are a counter."""
    ordered = sorted(names)
    keys = {natural_key(name) for name in ordered}
    number = _DECIMAL if len(keys) == len(ordered) else _WHOLE
    return sorted(ordered, key=lambda name: natural_key(name, number))


def number_keys(names: Sequence[str]) -> list[tuple[Decimal, ...]] | None:
    """The numbers that tell each of `names` (file names without suffix) from the others.

    Numbers that all names share, as in `cam0_0001`, do not count. None if a name has none, or two have the same.
    """
    parts = [tuple(map(Decimal, re.findall(_DECIMAL, name, re.ASCII))) for name in names]
    if not parts or not parts[0] or len({len(part) for part in parts}) > 1:
        return None
    columns = list(zip(*parts, strict=True))
    varying = [column for column in columns if len(set(column)) > 1] if len(names) > 1 else columns[-1:]
    keys = list(zip(*varying, strict=True))
    return keys if len(set(keys)) == len(names) else None


def numbers_of_names(names: Sequence[str]) -> list[float] | None:
    """The one number that tells each of `names` from the others; None if it takes more or less than one."""
    keys = number_keys(names)
    return [float(key[0]) for key in keys] if keys and len(keys[0]) == 1 else None


def match_names(wanted: Sequence[str], files: Mapping[str, T]) -> dict[str, T]:
    """Name in `wanted` -> what `files` has under that name, else under a name with the same numbers.

    Names without a partner are left out.
    """
    matched = {name: files[name] for name in wanted if name in files}
    if len(matched) in (len(wanted), len(files)):
        return matched
    keys, file_keys = number_keys(wanted), number_keys(list(files))
    if keys is None or file_keys is None:
        return matched
    by_number = dict(zip(file_keys, files, strict=True))
    for name, key in zip(wanted, keys, strict=True):
        partner = by_number.get(key)
        if name not in matched and partner is not None and partner not in matched:
            matched[name] = files[partner]
    return matched
