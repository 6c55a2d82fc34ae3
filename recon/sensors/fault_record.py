"""What was wrong with the sensors of a run, as sentences and as `sensors.json`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from ..core.files import write_text
from .fault_detection import Verdict

MIN_FRAMES = 3  # in a row are worth a word; shorter stretches stand in the file alone,
MIN_SHARE = 0.1  # unless there are many: a slower sensor has nothing new in every other frame
MAX_STRETCHES = 5  # are named
_WORDS: dict[Verdict, str] = {
    "missing": "no readings",
    "frozen": "frozen",
    "inconsistent": "at odds with the map",
}


@dataclass(frozen=True)
class Stretch:
    """Mapped frames in a row, `first` to `last`, in which a sensor had the same fault."""

    reason: Verdict
    first: int
    last: int
    frames: int


def stretches(verdicts: Mapping[int, Verdict]) -> list[Stretch]:
    """The faults of one sensor, from its verdicts by frame index."""
    found = []
    for reason, group in groupby(sorted(verdicts), key=lambda index: verdicts[index]):
        indices = list(group)
        if reason != "ok":
            found.append(Stretch(reason, indices[0], indices[-1], len(indices)))
    return found


def describe(sensor: str, verdicts: Mapping[int, Verdict]) -> list[str]:
    """One sentence for each kind of fault that lasted; none for a sensor that was well."""
    sentences = []
    for reason, words in _WORDS.items():
        all_of_it = [stretch for stretch in stretches(verdicts) if stretch.reason == reason]
        long = [stretch for stretch in all_of_it if stretch.frames >= MIN_FRAMES]
        count = sum(stretch.frames for stretch in all_of_it)
        if long and len(long) <= MAX_STRETCHES:
            where = " and ".join(f"from frame {stretch.first} to {stretch.last}" for stretch in long)
        elif count > MIN_SHARE * len(verdicts) and count >= MIN_FRAMES:
            where = f"in {count} of {len(verdicts)} frames"
        else:
            continue
        sentences.append(f"{sensor}: {words} {where}" + ("" if reason == "missing" else ", left out"))
    return sentences


def summarise(verdicts: Mapping[str, Mapping[int, Verdict]]) -> dict[str, dict[str, Any]]:
    """By sensor: mapped frames, those in which it was used, its faults."""
    return {
        sensor: {
            "frames": len(own),
            "used_frames": sum(verdict == "ok" for verdict in own.values()),
            "faults": [vars(stretch) for stretch in stretches(own)],
        }
        for sensor, own in verdicts.items()
    }


def save(path: Path, verdicts: Mapping[str, Mapping[int, Verdict]]) -> None:
    """Write `sensors.json`. Raises RunError."""
    content = {s: facts | {"sentences": describe(s, verdicts[s])} for s, facts in summarise(verdicts).items()}
    write_text(path, json.dumps({"sensors": content}, indent=1) + "\n")
