"""`uncle pretrain confidence`: a confidence network for one sensor, from recordings with true depth."""

from __future__ import annotations

import math
from pathlib import Path

import click

from .console import listener
from .options import data_option, device_option, max_minutes_option, prepare_option, seed_option
from .training_data import open_sources


@click.command("confidence")
@click.argument("datasets", nargs=-1, type=click.Path(path_type=Path))
@click.option("--sensor", metavar="NAME", help="The sensor to learn; its true depth must be there as the sensor gt.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="File to write the network to.")
@click.option(
    "--frames", type=click.IntRange(1), default=40, show_default=True, help="Frames of each data set, at most."
)
@click.option("--steps", type=click.IntRange(1), default=1500, show_default=True, help="Steps of the training.")
@click.option("--batch", type=click.IntRange(1), default=8, show_default=True, help="Crops in a step.")
@click.option("--crop", type=click.IntRange(16), default=96, show_default=True, help="Their side, pixels.")
@click.option("--accumulate", type=click.IntRange(1), default=1, show_default=True, help="Batches in a step.")
@click.option("--learning-rate", type=click.FloatRange(0, min_open=True), default=5e-5, show_default=True,
              help="Step size of RMSprop; it falls to a tenth.")  # fmt: skip
@click.option("--penalty", type=click.FloatRange(0, min_open=True), default=0.015, show_default=True,
              help="Lambda of the loss: readings with a smaller error, metres, are trusted fully.")  # fmt: skip
@max_minutes_option
@data_option
@prepare_option
@seed_option
@device_option
@click.pass_context
def command(
    ctx: click.Context, datasets: tuple[Path, ...], sensor: str | None, out: Path | None, frames: int, steps: int,
    batch: int, crop: int, accumulate: int, learning_rate: float, penalty: float, max_minutes: float | None,
    data: Path | None, prepare: Path | None, seed: int, device: str,
) -> None:  # fmt: skip
    """Train the confidence network of one sensor on the data sets or run directories DATASETS.

    One of them is held back, to choose the best state of the training: the last. `uncle synth` makes data sets with
    true depth.

    \b
    uncle pretrain confidence rooms/a rooms/b rooms/c --sensor sgm --out sgm.pt
    """
    from ..recon.core.device import choose_device
    from ..recon.core.events import Note
    from ..recon.methods.confidence.models import save_network
    from ..recon.methods.pretrain.confidence import ConfidenceTraining, train_confidence
    from ..recon.methods.pretrain.depth_pairs import DepthPairs

    if bool(datasets) == bool(data):
        raise click.UsageError("give data sets, or --data with a file that --prepare made")
    if datasets and sensor is None:
        raise click.UsageError("--sensor is missing: which of the data sets' sensors to learn")
    if (out is None) == (prepare is None):
        raise click.UsageError("give --out for the network, or --prepare for the data alone")
    say = listener(ctx)
    pairs = DepthPairs.load(data) if data else DepthPairs.collect(open_sources(datasets), str(sensor), frames, say)
    if prepare is not None:
        pairs.save(prepare)
        say(Note(f"{prepare}: {len(pairs)} frames of {pairs.sensor}; go on with --data {prepare}"))
        return
    assert out is not None  # or one of the checks above had failed
    limit = math.inf if max_minutes is None else 60 * max_minutes
    settings = ConfidenceTraining(steps, batch, crop, accumulate, learning_rate, penalty, seed, limit)
    trained = train_confidence(pairs, settings, str(choose_device(device)), say)
    save_network(out, pairs.sensor, trained.network, trained.recipe(pairs, settings))
    losses = f"loss of frames held back {trained.validation[0]:.4f} at first, {min(trained.validation):.4f} at best"
    say(Note(f"{out}: {pairs.sensor}, {trained.steps} steps, {losses}"))
