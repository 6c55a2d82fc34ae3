"""What the benchmark programs share: resumable results, told on stderr. The rest is in `recon/bench`."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from uncle.recon.core.events import Event, Note, Warn
from uncle.recon.evaluation.bench import records
from uncle.recon.evaluation.bench.process import Record


def carry_out(
    jobs: Sequence[Any], path: Path, execute: Callable[[Any], Record], is_done: Callable[[Any, Record], bool]
) -> tuple[dict[str, Record], dict[str, str]]:
    """`records.carry_out`, one job at a time."""
    return records.carry_out(jobs, path, execute, is_done, on_event=_say)


def _say(event: Event) -> None:
    if isinstance(event, Note | Warn):
        print(event.text, file=sys.stderr, flush=True)
