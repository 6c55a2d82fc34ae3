"""Loops compiled by numba. The machine code is kept between processes where a place for it can be written."""

from __future__ import annotations

import logging
import pickle
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

from numba import njit
from numba.core.caching import FunctionCache

Function = TypeVar("Function", bound=Callable[..., Any])

logger = logging.getLogger(__name__)


class _ForgivingCache(FunctionCache):
    """A cache that costs nothing but time where its files cannot be read or written, or are damaged."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except (OSError, EOFError, pickle.PickleError, ValueError, IndexError, AttributeError, ImportError):
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except (OSError, EOFError, pickle.PickleError):  # it reads the index of what is there first
            _say_once()


def compiled(**options: Any) -> Callable[[Function], Function]:
    """The decorator `numba.njit` with `options`, without the global lock, and with a cache that may fail.

    numba keeps machine code beside the source, else in the home directory, or in NUMBA_CACHE_DIR. Where none of them
    can be written, as in containers with a read-only installation, every process compiles anew.
    """

    def decorate(function: Function) -> Function:
        dispatcher = njit(nogil=True, **options)(function)
        try:
            dispatcher._cache = _ForgivingCache(function)  # type: ignore[no-untyped-call]  # what `cache=True` does, with a class of our own
        except (RuntimeError, OSError):
            _say_once()
        return cast(Function, dispatcher)

    return decorate


@cache
def _say_once() -> None:
    logger.warning(
        "compiled code cannot be kept: installation and home directory are not writable, so each command compiles it "
        "again (up to a minute); set NUMBA_CACHE_DIR to a folder that is"
    )
