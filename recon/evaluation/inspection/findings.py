"""What an inspection found."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from ...core.correction import Correction


class Verdict(StrEnum):
    """Whether the data fit; `UNKNOWN` where they do not show it."""

    OK = "ok"
    UNKNOWN = "unknown"
    DOUBT = "doubt"
    WRONG = "wrong"


@dataclass(frozen=True)
class Finding:
    """One line: what was checked, a number with its unit, a verdict, what was seen, and what mends it.

    `correction` is what `uncle preprocess --fix` would apply; None where nothing can be applied.
    """

    check: str
    verdict: Verdict
    value: float | None
    unit: str
    text: str
    remedy: str = ""
    correction: Correction | None = None

    @property
    def is_open(self) -> bool:
        """Whether there is something to do about it."""
        return self.verdict in (Verdict.DOUBT, Verdict.WRONG)

    @property
    def number(self) -> str:
        """The number with its unit, as text."""
        return "" if self.value is None else f"{self.value:g} {self.unit}"

    @property
    def full_text(self) -> str:
        """What was seen, and what mends it where there is something to do."""
        return f"{self.text}; {self.remedy}" if self.is_open and self.remedy else self.text

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "check": self.check,
            "verdict": str(self.verdict),
            "value": self.value,
            "unit": self.unit,
            "text": self.text,
            "remedy": self.remedy,
            "correction": self.correction.describe() if self.correction else None,
        }


def worst(findings: tuple[Finding, ...]) -> Finding | None:
    """The first `wrong` finding, else the first `doubt`, else None."""
    for verdict in (Verdict.WRONG, Verdict.DOUBT):
        for finding in findings:
            if finding.verdict is verdict:
                return finding
    return None
