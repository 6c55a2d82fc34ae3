"""`uncle pretrain senfunet`: the networks that fuse two sensors, from recordings with true depth and a true mesh."""

from __future__ import annotations

import math
from pathlib import Path

import click

from .console import listener
from .options import (
    SensorsCommand,
    data_option,
    device_option,
    max_minutes_option,
    prepare_option,
    seed_option,
    sensors_option,
)
from .training_data import open_sources


@click.command("senfunet", cls=SensorsCommand)
@click.argument("datasets", nargs=-1, type=click.Path(path_type=Path))
@sensors_option("The two sensors to fuse; with --prepare any number.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="File to write the networks to.")
@click.option("--voxel", type=click.FloatRange(0.001, 0.5), default=0.02, show_default=True, metavar="METRES",
              help="Voxel size of the maps that they will fuse.")  # fmt: skip
@click.option("--truncation", type=click.IntRange(2, 16), default=5, show_default=True,
              help="Truncation of distances, voxels.")  # fmt: skip
@click.option("--images", type=click.IntRange(1), default=24, show_default=True,
              help="Frames of each data set, at most.")  # fmt: skip
@click.option("--frames", type=click.IntRange(1), default=600, show_default=True, help="Frames fused in training.")
@click.option("--accumulate", type=click.IntRange(1), default=4, show_default=True, help="Of them in a step.")
@click.option("--bricks", type=click.IntRange(1), default=16, show_default=True,
              help="Cubes of 16 x 16 x 16 samples around each frame that are compared with the truth.")  # fmt: skip
@click.option("--learning-rate", type=click.FloatRange(0, min_open=True), default=2e-3, show_default=True,
              help="Step size of Adam; it falls to a tenth.")  # fmt: skip
@max_minutes_option
@data_option
@prepare_option
@seed_option
@device_option
@click.pass_context
def command(
    ctx: click.Context, datasets: tuple[Path, ...], sensors: tuple[str, ...], out: Path | None, voxel: float,
    truncation: int, images: int, frames: int, accumulate: int, bricks: int, learning_rate: float,
    max_minutes: float | None, data: Path | None, prepare: Path | None, seed: int, device: str,
) -> None:  # fmt: skip
    """Train the networks of the method senfunet for two sensors on the data sets or run directories DATASETS.

    The last of several is not learned from, but measured. Each needs poses, true depth (the sensor gt) and a true mesh,
    as `uncle synth` makes them.

    \b
    uncle pretrain senfunet rooms/a rooms/b rooms/c --sensors sl sgm --out sl-sgm.pt
    """
    from ..recon.core.device import choose_device
    from ..recon.core.events import Note
    from ..recon.methods.pretrain.senfunet import SenfunetTraining, train_senfunet
    from ..recon.methods.pretrain.senfunet_scenes import collect_scene, load_scenes, save_scenes

    if bool(datasets) == bool(data):
        raise click.UsageError("give data sets, or --data with a file that --prepare made")
    if (out is None) == (prepare is None):
        raise click.UsageError("give --out for the networks, or --prepare for the data alone")
    if prepare is None and len(sensors) != 2:
        raise click.UsageError("--sensors takes the two sensors to fuse")
    if prepare is not None and not sensors:
        raise click.UsageError("--sensors is missing: which of the data sets' sensors to keep")
    say = listener(ctx)
    scenes = load_scenes(data) if data else [
        collect_scene(name, source, sensors, images, voxel, truncation, say)
        for name, source in open_sources(datasets)
    ]  # fmt: skip
    if prepare is not None:
        save_scenes(prepare, scenes)
        say(Note(f"{prepare}: {len(scenes)} scenes with {', '.join(sensors)}; go on with --data {prepare}"))
        return
    assert out is not None  # or one of the checks above had failed
    limit = math.inf if max_minutes is None else 60 * max_minutes
    settings = SenfunetTraining(frames, accumulate, learning_rate, bricks, seed, limit)
    trained = train_senfunet(scenes, (sensors[0], sensors[1]), settings, str(choose_device(device)), say)
    trained.model.save(out, trained.recipe(scenes, settings))
    means = ", ".join(
        f"{name} {trained.errors[f'error_{name}_m'] * 100:.2f} cm" for name in (*sensors, "mean", "learned")
    )
    say(Note(f"{out}: mean error where both sensors read something: {means}"))
