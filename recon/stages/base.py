"""What the summaries of all stages have in common."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class StageSummary:
    """What every stage returns.

    unchanged   the earlier result was kept, because it was made with the same settings
    seconds     wall time of the stage; 0 where it kept an earlier result
    """

    unchanged: bool = False
    seconds: float = 0.0
