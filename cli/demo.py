"""`uncle demo`: the whole chain on a room made here and now; nothing is downloaded."""

from __future__ import annotations

import json
import time
from pathlib import Path

import click

from .main import COMMANDS, main
from .options import seed_option

SENSORS = ("sl", "sgm")
FRAMES, SIZE = 40, 224  # enough for a whole room, and well below five minutes on two cores
VOXEL_M = 0.03  # about what one pixel covers at 3 m


@click.command("demo")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("demo"), show_default="./demo",
    help="Folder for the data set and the run.",
)  # fmt: skip
@click.option("--frames", type=click.IntRange(2), default=FRAMES, show_default=True, help="Number of images.")
@click.option("--size", type=click.IntRange(32, 2048), default=SIZE, show_default=True, help="Their size in pixels.")
@seed_option
@click.pass_context
def command(ctx: click.Context, out: Path, frames: int, size: int, seed: int) -> None:
    """Make a furnished room, reconstruct it with two simulated sensors and write a report.

    The stages are the other commands, each announced with the line that runs it alone. What is done already is kept:
    a second demo in the same folder ends at once.
    """
    room, run = out / "room", out / "run"
    again = [] if _is_made(room, frames, size, seed) else ["--overwrite"]
    stages = [
        ["synth", str(room), "--frames", str(frames), "--size", str(size), "--seed", str(seed), "--sensors", *SENSORS],
        ["preprocess", str(room), "--run", str(run)],
        ["map", "--run", str(run), "--sensors", *SENSORS, "--voxel", str(VOXEL_M), "--seed", str(seed)],
        ["mesh", "--run", str(run)],
        ["eval", "--run", str(run)],
        ["report", "--run", str(run)],
    ]
    started = time.monotonic()
    for number, (name, *arguments) in enumerate(stages, start=1):
        if name == "synth" and not again:
            click.echo(f"[{number}/{len(stages)}] {name}: the room in {room} is there already", err=True)
            continue
        extra = again if name not in ("eval", "report") else []
        click.echo(f"[{number}/{len(stages)}] {COMMANDS[name]}\n      uncle {name} {' '.join(arguments)}", err=True)
        _run(ctx, name, [*arguments, *extra])
    click.echo(f"Done in {time.monotonic() - started:.0f} s. Open the report in a browser.", err=True)


def _run(ctx: click.Context, name: str, arguments: list[str]) -> None:
    """Run another command as the command line would; its bars end with it."""
    command = main.get_command(ctx, name)
    if command is None:
        raise click.UsageError(f"there is no command {name}")
    with command.make_context(name, arguments, parent=ctx) as inner:
        command.invoke(inner)


def _is_made(room: Path, frames: int, size: int, seed: int) -> bool:
    """Whether a whole data set of these settings is there; its description is written last."""
    try:
        found = json.loads((room / "synth.json").read_text())["parameters"]
        return (found["frames"], found["size_px"], found["seed"], found["mesh"]) == (frames, size, seed, None)
    except (OSError, ValueError, KeyError, TypeError):
        return False
