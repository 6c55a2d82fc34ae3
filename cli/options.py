"""Options that several commands share: one name, one meaning, one help text."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

run_option = click.option(
    "--run", "run_path", type=click.Path(path_type=Path, file_okay=False), envvar="UNCLE_RUN", default=Path("run"),
    show_default="./run", help="Run directory (environment: UNCLE_RUN).",
)  # fmt: skip
wait_option = click.option(
    "--wait", is_flag=True, help="Wait while another command writes into the run, instead of ending with an error."
)
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
max_minutes_option = click.option(
    "--max-minutes", type=click.FloatRange(0, min_open=True), default=None,
    help="End the training after this time; the result then depends on the machine.",
)  # fmt: skip
data_option = click.option(
    "--data", type=click.Path(path_type=Path, dir_okay=False), default=None,
    help="Learn from a file of --prepare instead of data sets.",
)  # fmt: skip
prepare_option = click.option(
    "--prepare", type=click.Path(path_type=Path, dir_okay=False), default=None,
    help="Only write what would be learned from to one small file, for another machine.",
)  # fmt: skip


KNOWN_SENSORS = frozenset({"depth", "gt", "sl", "tof", "sgm", "psmnet"})


class SensorsCommand(click.Command):
    """A command whose `--sensors` takes several values after one flag: `--sensors sl psmnet`.

    Click options cannot take a variable number of values, so `--sensors a b` is rewritten into
    `--sensors a --sensors b` before parsing. A command may name further such flags.
    """

    several: tuple[str, ...] = ("--sensors",)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Repeat the flag before each of its values, then parse as usual."""
        has_positionals = any(isinstance(parameter, click.Argument) for parameter in self.params)
        return super().parse_args(ctx, expand_values(args, self.several, spare_paths=has_positionals))


def expand_sensors(args: list[str], spare_paths: bool = False) -> list[str]:
    """`expand_values` for `--sensors` alone."""
    return expand_values(args, ("--sensors",), spare_paths)


def expand_values(args: list[str], flags: tuple[str, ...], spare_paths: bool = False) -> list[str]:
    """Repeat each of `flags` before each of its values; everything else passes through.

    The values end at the next token that starts with a dash. With `spare_paths`, they end at a path too, so that
    `--sensors sl psmnet DATASET` works: a token with a path separator or a colon, or of an existing file or folder
    unless it is the usual name of a sensor. Raises UsageError if there is no value.
    """
    expanded: list[str] = []
    taking = ""
    for position, token in enumerate(args):
        if taking and spare_paths and _is_path(token) and args[position - 1] != taking:
            taking = ""
        if token in flags:
            if position + 1 == len(args) or args[position + 1].startswith("-"):
                needed = "the name of at least one sensor" if token == "--sensors" else "at least one value"
                raise click.UsageError(f"{token} needs {needed}")
            taking = token
        elif token.startswith("-"):
            taking = ""
            expanded.append(token)
            if token == "--":
                return expanded + args[position + 1 :]
        else:
            expanded += [taking, token] if taking else [token]
    return expanded


def _is_path(token: str) -> bool:
    return any(mark in token for mark in ("/", ":", os.sep)) or (token not in KNOWN_SENSORS and os.path.exists(token))


class FrameRange(click.ParamType[slice]):
    """`start:stop:step` as in a Python slice, with a positive step; a slice."""

    name = "range"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> slice:
        """Parse `start:stop:step`. Raises BadParameter."""
        if isinstance(value, slice):
            return value
        try:
            parts = [int(part) if part else None for part in value.split(":")]
        except ValueError:
            parts = []
        if not 2 <= len(parts) <= 3 or (len(parts) == 3 and parts[2] is not None and parts[2] < 1):
            self.fail(f"{value!r} is not start:stop:step with whole numbers, such as 0:300 or ::10", param, ctx)
        return slice(*parts)


def sensors_option(help: str) -> Callable[[Any], Any]:
    """`--sensors A [B ...]`; use together with `cls=SensorsCommand`."""
    return click.option("--sensors", "sensors", multiple=True, metavar="NAME [NAME ...]", help=help)
