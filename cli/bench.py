"""`uncle bench`: run several methods on one protocol and compare them."""

from __future__ import annotations

import click

from .main import LazyGroup

# comparison -> one-line help; its command is in bench_NAME.py
BENCHES: dict[str, str] = {
    "paper": "The paper's tables: methods, sensors, given poses and tracking, over seeds.",
}


@click.group("bench", cls=LazyGroup, lazy=BENCHES, prefix="bench_")
def command() -> None:
    """Run several methods on one protocol and compare them; docs/bench.md describes the tables."""
