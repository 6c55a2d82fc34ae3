"""`uncle synth`: make a multi-sensor data set from a furnished room or from a mesh."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener
from .options import SensorsCommand, seed_option, sensors_option


@click.command(cls=SensorsCommand)
@click.argument("out", type=click.Path(path_type=Path))
@click.option(
    "--mesh", type=click.Path(path_type=Path), help="Your own room (GLB, OBJ, PLY; metres) instead of a made one."
)
@click.option(
    "--up", type=click.Choice(["z", "y"]), default="z", show_default=True, help="Axis of --mesh that points up."
)
@click.option("--frames", type=click.IntRange(1), default=130, show_default=True, help="Number of images.")
@click.option(
    "--size", type=click.IntRange(32, 2048), default=384, show_default=True, help="Width and height in pixels."
)
@sensors_option("Sensors to simulate: sl (= sl-handa), sl-habitat, tof, tof-habitat, sgm, dense.  [default: sl sgm]")
@click.option(
    "--loops", type=click.IntRange(0), default=0, show_default=True, help="How often the path returns to its start."
)
@click.option(
    "--corridor",
    "corridor_m",
    type=float,
    default=0.0,
    metavar="METRES",
    help="A corridor of this length with corners instead of a room; the frames are spread over it.",
)
@seed_option
@click.option("--overwrite", is_flag=True, help="Replace the data set in OUT.")
@click.pass_context
def command(
    ctx: click.Context, out: Path, mesh: Path | None, up: str, frames: int, size: int, sensors: tuple[str, ...],
    loops: int, corridor_m: float, seed: int, overwrite: bool,
) -> None:  # fmt: skip
    """Make a data set in OUT: stereo colour, exact depth, simulated depth sensors, poses and the true mesh.

    The room, its furniture and the hand-held path follow from the seed. docs/synth.md says what is simulated by what.

    \b
    uncle synth room --sensors sl sgm tof
    uncle synth mine --mesh room.glb --up y --loops 2
    uncle synth long --corridor 200 --frames 4000
    """
    from ..datasets.synth.write import SynthOptions, make_dataset
    from ..recon.core.events import Note

    on_event = listener(ctx)
    options = SynthOptions(frames, size, seed, mesh, up, sensors or ("sl", "sgm"), loops, corridor_m)
    make_dataset(out, options, overwrite=overwrite, on_event=on_event)
    on_event(Note(f"{out}: {frames} frames; go on with `uncle preprocess {out}`"))
