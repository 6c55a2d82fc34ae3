"""`uncle report`: one page about a run."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener
from .options import run_option


@click.command("report")
@run_option
@click.option(
    "--renderer", type=click.Choice(["auto", "offscreen", "raycast"]), default="auto", show_default=True,
    help="Who draws the mesh: Open3D's OffscreenRenderer or the CPU ray caster.",
)  # fmt: skip
@click.pass_context
def command(ctx: click.Context, run_path: Path, renderer: str) -> None:
    """Write RUN/report.html: pictures, metrics, sensor noise, curves, timings and configuration on one page.

    The page carries everything it shows; what the run does not hold is left out, with the command that makes it.
    """
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.report import write_report

    click.echo(str(write_report(RunDirectory(run_path), renderer, listener(ctx))))
