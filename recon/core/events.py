"""Events that the library reports to its caller while it works. It never prints; the caller shows them."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar


@dataclass(frozen=True)
class Progress:
    """`done` of `total` units of `stage` are finished. `done == 0` opens the stage, `done == total` closes it."""

    stage: str
    done: int
    total: int
    unit: str = "frames"


@dataclass(frozen=True)
class Note:
    """One line of information."""

    text: str


@dataclass(frozen=True)
class Warn:
    """One line about something that was skipped, replaced or doubtful."""

    text: str


Event = Progress | Note | Warn
OnEvent = Callable[[Event], None]

T = TypeVar("T")


def ignore(event: Event) -> None:
    """A listener that does nothing."""


def track_progress(items: Iterable[T], total: int, stage: str, on_event: OnEvent, unit: str = "frames") -> Iterator[T]:
    """Yield `items` and report after each one."""
    on_event(Progress(stage, 0, total, unit))
    for done, item in enumerate(items, start=1):
        yield item
        on_event(Progress(stage, done, total, unit))
