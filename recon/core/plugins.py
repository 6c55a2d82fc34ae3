"""Specifications that installed packages add to the program through entry points.

A package names an object under an entry-point group in its own pyproject.toml:

    [project.entry-points."uncle.methods"]
    my-method = "my_package.specs:MY_METHOD"
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from importlib.metadata import EntryPoint, entry_points
from typing import Any, TypeVar

from .errors import UncleError

Spec = TypeVar("Spec")


def load_plugins(group: str, kind: type[Spec], register: Callable[[Spec], None]) -> list[str]:
    """Register the object of every entry point of `group`; returns a line for each one that was skipped.

    An entry point is skipped if it cannot be imported, is not a `kind`, or if `register` refuses it, for example as
    its name is taken. No defect of an installed package may keep the program from working.
    """
    problems = []
    for point in _sorted_entry_points(group):
        package = point.dist.name if point.dist is not None else point.value
        try:
            spec = point.load()
            if not isinstance(spec, kind):
                raise TypeError(f"{point.value} is not a {kind.__name__}")
            register(spec)
        except Exception as error:
            kind_of_error = "" if isinstance(error, UncleError) else f"{type(error).__name__}: "
            reason = " ".join(f"{kind_of_error}{error}".split())
            problems.append(f"skipped {point.name!r} of the package {package} ({group}): {reason}")
    return problems


def import_object(name: str, package: str) -> Any:
    """The object `module:attribute`; a module that starts with a dot is relative to `package`."""
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module, package), attribute)


def _sorted_entry_points(group: str) -> Iterator[EntryPoint]:
    """In the order of their names, so that the one that wins a name does not depend on the file system."""
    yield from sorted(entry_points(group=group), key=lambda point: (point.name, point.value))
