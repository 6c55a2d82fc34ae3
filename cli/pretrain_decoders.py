"""`uncle pretrain decoders`: train the occupancy decoders of the feature grids."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener
from .options import device_option, seed_option


@click.command("decoders")
@click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), default=Path("decoders.pt"), show_default=True,
    help="File for the weights and their recipe.",
)  # fmt: skip
@click.option(
    "--steps", type=click.IntRange(1), default=4000, show_default=True, help="Steps of the training."
)  # fmt: skip
@click.option(
    "--cubes", type=click.IntRange(12), default=24, show_default=True,
    help="Pieces of rooms that are learned from at once, a multiple of 12; about 512 fill a large GPU.",
)  # fmt: skip
@seed_option
@device_option
@click.option("--overwrite", is_flag=True, help="Replace a finished file.")
@click.pass_context
def command(ctx: click.Context, out: Path, steps: int, cubes: int, seed: int, device: str, overwrite: bool) -> None:
    """Train the middle and the fine decoder on synthetic rooms, score them on rooms never seen, and write OUT.

    Nothing is downloaded and no recording is needed. An interrupted training goes on when the same command is run
    again. docs/pretraining.md describes the recipe and how to use the weights.

    \b
    uncle pretrain decoders --out decoders.pt
    uncle pretrain decoders --cubes 516 --steps 6000 --device cuda
    """
    from ..recon.core.device import choose_device
    from ..recon.methods.pretrain.decoder_run import pretrain_decoders
    from ..recon.methods.pretrain.decoder_training import DecoderTraining

    settings = DecoderTraining(steps=steps, cubes=cubes, seed=seed)
    pretrain_decoders(out, settings, choose_device(device), overwrite=overwrite, on_event=listener(ctx))
