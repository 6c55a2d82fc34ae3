"""`uncle report`: one page about a run."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener
from .options import run_option, wait_option


@click.command("report")
@run_option
@wait_option
@click.option(
    "--renderer", type=click.Choice(["auto", "offscreen", "raycast"]), default="auto", show_default=True,
    help="Draw the mesh with Open3D's OffscreenRenderer (needs a driver) or the CPU ray caster.",
)  # fmt: skip
@click.pass_context
def command(ctx: click.Context, run_path: Path, wait: bool, renderer: str) -> None:
    """Write RUN/report.html: pictures, metrics, sensor noise, curves, timings and configuration on one page.

    The page needs no other file. For what the run does not hold yet, it names the command that makes it.
    """
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.report import report_run

    click.echo(str(report_run(RunDirectory(run_path, wait), renderer, listener(ctx))))
