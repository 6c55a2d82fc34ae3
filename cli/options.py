"""Options that several commands share: one name, one meaning, one help text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

run_option = click.option(
    "--run", "run_path", type=click.Path(path_type=Path, file_okay=False), envvar="UNCLE_RUN", default=Path("run"),
    show_default="./run", help="Run directory (environment: UNCLE_RUN).",
)  # fmt: skip
overwrite_option = click.option("--overwrite", is_flag=True, help="Redo the stage even if it is done and unchanged.")
json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print JSON (SI units, ratios 0..1) instead of a table."
)
seed_option = click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of all randomness."
)
device_option = click.option(
    "--device",
    type=click.Choice(["auto", "cpu", "cuda"]),
    default="auto",
    show_default=True,
    help="Where tensors live.",
)


class SensorsCommand(click.Command):
    """A command whose `--sensors` takes several values after one flag: `--sensors sl psmnet`.

    Click options cannot take a variable number of values, so `--sensors a b` is rewritten into
    `--sensors a --sensors b` before parsing. The values end at the next token that starts with a dash.
    """

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        return super().parse_args(ctx, expand_sensors(args))


def expand_sensors(args: list[str]) -> list[str]:
    """Repeat `--sensors` before each of its values; everything else passes through."""
    expanded: list[str] = []
    taking = False
    for token in args:
        if token == "--sensors":
            taking = True
        elif token.startswith("-"):
            taking = False
            expanded.append(token)
        else:
            expanded += ["--sensors", token] if taking else [token]
    return expanded


def sensors_option(help: str) -> Callable[[Any], Any]:
    """`--sensors A [B ...]`; use together with `cls=SensorsCommand`."""
    return click.option("--sensors", "sensors", multiple=True, metavar="NAME [NAME ...]", help=help)
