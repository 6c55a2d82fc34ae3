"""`uncle inspect`: check whether the parts of a recording fit one another."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .console import listener, print_json
from .options import SensorsCommand, json_option, sensors_option

if TYPE_CHECKING:
    from ..recon.evaluation.inspection import Finding


@click.command("inspect", cls=SensorsCommand)
@click.argument("dataset", type=click.Path(path_type=Path), metavar="DATASET|RUN")
@click.option("--format", "format_name", metavar="NAME", help="Format of the data set; detected if not given.")
@sensors_option("Depth sensors to inspect; all if not given.")
@click.option("--report", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE.html",
              help="Write a page with pictures.")  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    dataset: Path,
    format_name: str | None,
    sensors: tuple[str, ...],
    report: Path | None,
    as_json: bool,
) -> None:
    """Check whether depth, colour, intrinsics, poses and clocks of a recording fit one another.

    Each line has a verdict: ok; unknown, where the data do not show it; doubt; or wrong, with what mends it. Nothing is
    changed; `uncle preprocess --fix` applies what can be mended. DATASET is a recording, RUN a run directory. The exit
    code is 1 if something is wrong. docs/inspect.md explains the checks.

    \b
    uncle inspect recording
    uncle inspect recording --sensors sl --report inspection.html
    """
    from ..datasets.registry import open_dataset
    from ..recon.core.events import Note
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.inspect import inspect_dataset, inspect_run

    on_event = listener(ctx)
    run = RunDirectory(dataset)
    if run.manifest_path.is_file():
        inspection = inspect_run(run, sensors, report, on_event)
    else:
        inspection = inspect_dataset(open_dataset(dataset, format_name, on_event), sensors, report, on_event)
    if as_json:
        print_json({"findings": [finding.to_dict() for finding in inspection.findings]})
    else:
        click.echo("\n".join(_line(finding) for finding in inspection.findings))
    if report is not None:
        on_event(Note(f"page: {report}"))
    first = inspection.first
    if first is not None and first.verdict == "wrong":
        ctx.exit(1)


def _line(finding: Finding) -> str:
    color = {"ok": "green", "doubt": "yellow", "wrong": "red"}.get(str(finding.verdict))
    number = f"  [{finding.number}]" if finding.number else ""
    return f"{click.style(f'{finding.verdict:<8}', fg=color)} {finding.check:<20} {finding.full_text}{number}"
