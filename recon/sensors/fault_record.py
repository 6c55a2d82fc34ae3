"""The faults of the sensors of a run, as sentences and as `sensors.json`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from ..core.files import write_text
from .fault_detection import Verdict

MIN_FRAMES = 3  # in a row: shorter intervals are in the file, but get no sentence,
MIN_FRAME_RATIO = 0.1  # unless there are many: a slow sensor repeats its image in every other frame
MAX_INTERVALS = 5  # that one sentence lists
_DESCRIPTIONS: dict[Verdict, str] = {
    "missing": "no measurements",
    "frozen": "frozen",
    "inconsistent": "inconsistent with the map",
}


@dataclass(frozen=True)
class FaultInterval:
    """Consecutive mapped frames, index `first` to `last`, in which a sensor had the same fault."""

    reason: Verdict
    first: int
    last: int
    frames: int


def fault_intervals(verdicts: Mapping[int, Verdict]) -> list[FaultInterval]:
    """The faults of one sensor, from its verdicts by frame index."""
    intervals = []
    for reason, group in groupby(sorted(verdicts), key=lambda index: verdicts[index]):
        indices = list(group)
        if reason != "ok":
            intervals.append(FaultInterval(reason, indices[0], indices[-1], len(indices)))
    return intervals


def fault_sentences(sensor: str, verdicts: Mapping[int, Verdict]) -> list[str]:
    """One sentence for each kind of fault that lasted; none for a sensor without faults."""
    sentences = []
    for reason, description in _DESCRIPTIONS.items():
        intervals = [interval for interval in fault_intervals(verdicts) if interval.reason == reason]
        long = [interval for interval in intervals if interval.frames >= MIN_FRAMES]
        count = sum(interval.frames for interval in intervals)
        if long and len(long) <= MAX_INTERVALS:
            frames = " and ".join(f"from frame {interval.first} to {interval.last}" for interval in long)
        elif count > MIN_FRAME_RATIO * len(verdicts) and count >= MIN_FRAMES:
            frames = f"in {count} of {len(verdicts)} frames"
        else:
            continue
        sentences.append(f"{sensor}: {description} {frames}" + ("" if reason == "missing" else ", left out"))
    return sentences


def fault_summary(verdicts: Mapping[str, Mapping[int, Verdict]]) -> dict[str, dict[str, Any]]:
    """By sensor: the number of mapped frames, of those in which it was used, and its faults."""
    return {
        sensor: {
            "frames": len(by_frame),
            "used_frames": sum(verdict == "ok" for verdict in by_frame.values()),
            "faults": [vars(interval) for interval in fault_intervals(by_frame)],
        }
        for sensor, by_frame in verdicts.items()
    }


def save_faults(path: Path, verdicts: Mapping[str, Mapping[int, Verdict]]) -> None:
    """Write `sensors.json`. Raises RunError."""
    summary = fault_summary(verdicts)
    content = {s: facts | {"sentences": fault_sentences(s, verdicts[s])} for s, facts in summary.items()}
    write_text(path, json.dumps({"sensors": content}, indent=1) + "\n")
