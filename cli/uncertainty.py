"""`uncle uncertainty`: how far each sensor of a run can be trusted, as figures and pictures."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener, print_json, print_table
from .options import json_option, run_option


@click.command("uncertainty")
@run_option
@click.option("--sensor", "sensors", multiple=True, metavar="NAME", help="Repeatable.  [default: all in the map]")
@click.option("--frame", type=click.IntRange(0), default=None, metavar="N",
              help="Draw this frame.  [default: a few, evenly spread]")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the pictures.  "
              "[default: RUN/snapshots]")  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context, run_path: Path, sensors: tuple[str, ...], frame: int | None, out: Path | None, as_json: bool
) -> None:
    """Show how far each sensor of a map can be trusted.

    Beta is the mean error that a reading promises. Printed are each sensor's share in the map, its typical betas and,
    where the data set has the true depth, whether they are kept; drawn are depth, beta and true error side by side, the
    noise against depth and slant, and the calibration. docs/uncertainty.md explains the figures.

    \b
    uncle uncertainty
    uncle uncertainty --sensor sgm --frame 40 --out pictures
    """
    from ..recon.core.events import Note
    from ..recon.core.json_values import to_plain
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.uncertainty import uncertainty_run
    from ..recon.visualization.uncertainty_table import summary_table

    run, say = RunDirectory(run_path), listener(ctx)
    found = uncertainty_run(run, out or run.snapshots_path, sensors, frame, on_event=say)
    say(Note(f"drawn: {', '.join(found.pictures)}"))
    if as_json:
        print_json(to_plain(found))
        return
    print_table("Uncertainty", *summary_table(found.sensors))
    for sensor, reason in found.skipped.items():
        click.echo(f"left out: {sensor}: {reason}")
