"""Values as JSON takes them."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from pydantic import ValidationError

_MAX_PROBLEM = 300  # characters


def to_plain(value: Any) -> Any:
    """Nested dataclasses, tuples and numbers as JSON can hold them; what is not finite becomes None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [to_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def first_problem(error: Exception) -> str:
    """One line on why a value does not fit its model (pydantic lists all reasons), or on any other error."""
    text = str(error)
    if isinstance(error, ValidationError):
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        text = f"{where}: {first['msg'].removeprefix('Value error, ')}"
    text = " ".join(text.split())  # some quote the whole file
    return text if len(text) <= _MAX_PROBLEM else text[:_MAX_PROBLEM] + " ..."
