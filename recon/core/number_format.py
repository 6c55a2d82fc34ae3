"""Numbers as text for tables: "-" stands for a value that is unknown."""

from __future__ import annotations

UNKNOWN = "-"


def format_number(value: float | None, digits: int = 3, factor: float = 1.0) -> str:
    """`value` times `factor` with `digits` decimals."""
    return UNKNOWN if value is None else f"{value * factor:.{digits}f}"


def format_cm(metres: float | None, digits: int = 2) -> str:
    """A length in metres as centimetres."""
    return format_number(metres, digits, 100.0)


def format_percent(ratio: float | None, digits: int = 2) -> str:
    """A ratio from 0 to 1 as per cent."""
    return format_number(ratio, digits, 100.0)


def format_grouped(number: int) -> str:
    """1234567 -> "1 234 567"."""
    return f"{number:,}".replace(",", " ")
