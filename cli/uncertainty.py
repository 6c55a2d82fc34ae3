"""`uncle uncertainty`: the error scale of each sensor of a map, as numbers and pictures."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener, print_json, print_table
from .options import json_option, run_option, wait_option


@click.command("uncertainty")
@run_option
@wait_option
@click.option("--sensor", "sensors", multiple=True, metavar="NAME", help="Repeatable.  [default: all in the map]")
@click.option("--frame", type=click.IntRange(0), default=None, metavar="N",
              help="Draw this frame.  [default: a few, evenly spread]")  # fmt: skip
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="Folder for the pictures.  "
              "[default: RUN/snapshots]")  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context, run_path: Path, wait: bool, sensors: tuple[str, ...], frame: int | None, out: Path | None,
    as_json: bool,
) -> None:  # fmt: skip
    """Show the error scale (beta) that a map learned for each sensor.

    Beta is the expected absolute error of a measurement. Printed are the weight share of each sensor, its typical betas
    and, where the data set has the true depth, how well they are calibrated. Drawn are depth, beta and true error side
    by side, the noise against depth and incidence angle, and the calibration. docs/uncertainty.md explains the numbers.

    \b
    uncle uncertainty
    uncle uncertainty --sensor sgm --frame 40 --out pictures
    """
    from ..recon.core.events import Note
    from ..recon.core.json_values import to_plain
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.uncertainty import uncertainty_run
    from ..recon.visualization.uncertainty_table import summary_table

    run, on_event = RunDirectory(run_path, wait), listener(ctx)
    summary = uncertainty_run(run, out or run.snapshots_path, sensors, frame, on_event=on_event)
    on_event(Note(f"drawn: {', '.join(summary.pictures)}"))
    if as_json:
        plain = to_plain(summary)
        print_json({key: plain[key] for key in ("run", "sensors", "skipped", "pictures")})
        return
    print_table("Uncertainty", *summary_table(summary.sensors))
    for sensor, reason in summary.skipped.items():
        click.echo(f"left out: {sensor}: {reason}")
