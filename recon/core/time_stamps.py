"""Time stamps of streams that were recorded together: their unit, and why two of them do not meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

EPOCH_S = 1e8  # a larger number of seconds counts from 1970 (this is 1973)
MAX_TIME_STAMP = 1e20  # a larger number is damaged; nanoseconds since 1970 are 2e18
MAX_STEP_S = 10.0  # frames and poses follow each other faster
MAX_KEYFRAME_STEP_S = 1000.0  # and keyframes, whose time stamps count from 1970 if their size allows it
SAME_DURATION = 5.0  # ratio of the time that two streams of a recording cover, at most
ZONE_S, ZONE_TOLERANCE_S = 900.0, 30.0  # time zones differ by whole quarters of an hour


@dataclass(frozen=True)
class TimeUnit:
    """A unit of time stamps and its length in seconds."""

    name: str
    seconds: float


SECONDS = TimeUnit("seconds", 1.0)
_UNITS: tuple[TimeUnit, ...] = (
    SECONDS,
    TimeUnit("milliseconds", 1e-3),
    TimeUnit("microseconds", 1e-6),
    TimeUnit("nanoseconds", 1e-9),
)


def unit_of(stamps: np.ndarray) -> TimeUnit:
    """The unit of time stamps (N,) by their size if they count from 1970, else by the step between them.

    A step is assumed to last 10 ms to 10 s; a step of less than 10 means seconds.
    """
    finite = stamps[np.isfinite(stamps)]
    if not finite.size:
        return SECONDS
    largest = float(np.abs(finite).max())
    step = median_step(finite)
    for unit in reversed(_UNITS[1:]):
        if largest * unit.seconds >= EPOCH_S and step * unit.seconds < MAX_KEYFRAME_STEP_S:
            return unit
    if 10 * EPOCH_S <= largest < 22 * EPOCH_S and step < MAX_KEYFRAME_STEP_S:
        return SECONDS  # since 1970, with long steps
    for unit in _UNITS:
        if step * unit.seconds < MAX_STEP_S:
            return unit
    return _UNITS[-1]


def common_units(first: np.ndarray, second: np.ndarray) -> tuple[TimeUnit, TimeUnit]:
    """Units of two streams (N,), (M,) of one recording.

    They are the same if the numbers overlap, that of the faster stream; unless the recording lasts as long in both
    streams only with the units that each shows by itself, as seconds and milliseconds from 0.
    """
    separate = unit_of(first), unit_of(second)
    if not (first.size and second.size and ranges_overlap(first, second)):
        return separate
    faster = min((stream for stream in (first, second) if stream.size > 1), key=median_step, default=first)
    shared = unit_of(faster), unit_of(faster)
    lasts = float(np.ptp(first)), float(np.ptp(second))
    if separate[0] != separate[1] and min(lasts) > 0:
        ratio = lasts[0] / lasts[1]
        as_separate = abs(np.log(ratio * separate[0].seconds / separate[1].seconds))
        if as_separate < np.log(SAME_DURATION) and as_separate < abs(np.log(ratio)):
            return separate
    return shared


def median_step(stamps: np.ndarray) -> float:
    """Median difference of successive time stamps (N,); 0 if there are fewer than two."""
    steps = np.diff(np.unique(stamps))
    return float(np.median(steps)) if steps.size else 0.0


def ranges_overlap(first: np.ndarray, second: np.ndarray) -> bool:
    """Whether the time spans of two streams have a moment in common."""
    return bool(first.min() <= second.max() and second.min() <= first.max())


def explain_mismatch(
    first_name: str, first: np.ndarray, second_name: str, second: np.ndarray, max_gap_s: float, rule: str
) -> str:
    """Why no time stamp of one stream meets one of the other: clock, unit or rate.

    `first` (N,) and `second` (M,) are finite; `rule` says what happens across more than `max_gap_s` seconds.
    """
    spans = f"({first.min():.3f} to {first.max():.3f}) do not meet those of {second_name} ({_span(second)})"
    if not ranges_overlap(first, second):
        return f"{first_name}: its time stamps {spans}: {_clock_difference(first, second)}"
    nearest = float(np.abs(first[:, None] - second[None, :]).min()) if first.size * second.size < 10**7 else np.nan
    steps = f"its time stamps are {_duration(median_step(first))} apart, those of {second_name} "
    steps += f"{_duration(median_step(second))}, and the nearest two differ by {_duration(nearest)}"
    return f"{first_name}: {steps}; {rule} more than {_duration(max_gap_s)}"


def _span(stamps: np.ndarray) -> str:
    return f"{stamps.min():.3f} to {stamps.max():.3f}"


def _clock_difference(first: np.ndarray, second: np.ndarray) -> str:
    early, late = sorted((first, second), key=lambda stamps: float(stamps.min()))
    offset = float(late.min() - early.min())
    if late.min() > EPOCH_S > early.max():
        return "one clock counts from 1970, the other from the start of the recording; bring both to one clock"
    zones = round(offset / ZONE_S)
    lasts = max(float(np.ptp(first)), float(np.ptp(second)))
    if 0 < zones <= 14 * 4 and abs(offset - zones * ZONE_S) < ZONE_TOLERANCE_S and lasts < ZONE_S:
        return (
            f"they are {zones * ZONE_S / 3600:g} hours apart, which looks like another time zone; correct one of them"
        )
    return f"they lie {_duration(float(late.min() - early.max()))} apart; check that both are of one recording"


def _duration(seconds: float) -> str:
    if seconds < 0.01:
        return f"{seconds * 1e3:.3g} ms"
    return f"{seconds:.3f} s" if seconds < 1000 else f"{seconds:.0f} s"
