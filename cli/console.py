"""How the program talks: bars and lines on stderr, tables and JSON on stdout."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from typing import Any, NoReturn

import click
from tqdm import tqdm

from ..recon.core.events import Event, Note, Progress, Warn


class Console:
    """Listener for library events: one bar per stage with rate and time left, notes and warnings between."""

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self._bar: tqdm[NoReturn] | None = None

    def __call__(self, event: Event) -> None:
        """Show one event."""
        if self.quiet:
            return
        match event:
            case Progress():
                self._advance(event)
            case Note(text):
                self._line(text)
            case Warn(text):
                self._line(click.style("warning: ", fg="yellow") + text)

    def _advance(self, event: Progress) -> None:
        if self._bar is None or self._bar.desc.removesuffix(": ") != event.stage:
            self.close()
            self._bar = tqdm(
                total=event.total, desc=event.stage, unit=f" {event.unit}", file=sys.stderr, delay=1.0, leave=True,
                mininterval=0.2 if sys.stderr.isatty() else 5.0, dynamic_ncols=True,
            )  # fmt: skip
        self._bar.update(event.done - self._bar.n)
        if event.done >= event.total:
            self.close()

    def _line(self, text: str) -> None:
        with tqdm.external_write_mode(file=sys.stderr):
            click.echo(text, err=True)

    def close(self) -> None:
        """End the open bar, if any."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def listener(ctx: click.Context) -> Console:
    """The console of this invocation; honours `uncle --quiet`. Its bar is closed however the command ends."""
    console = Console(quiet=bool((ctx.find_root().obj or {}).get("quiet")))
    ctx.call_on_close(console.close)
    return console


def print_table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table for people on stdout."""
    from rich.console import Console as RichConsole
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    for position, name in enumerate(header):
        table.add_column(name, justify="left" if position == 0 else "right")
    for row in rows:
        table.add_row(*row)
    RichConsole(file=sys.stdout).print(table)


def print_json(value: Any) -> None:
    """Print JSON for machines on stdout: SI units, ratios 0..1."""
    click.echo(json.dumps(value, indent=2, sort_keys=True))
