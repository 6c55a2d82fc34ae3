"""`uncle preprocess`: convert a recording into a run directory."""

from __future__ import annotations

from pathlib import Path

import click

from ..datasets.registry import open_dataset, reader_specs
from .console import listener
from .options import FrameRange, SensorsCommand, overwrite_option, run_option, sensors_option, wait_option


def _format_help() -> str:
    readers = "; ".join(f"{spec.name}: {spec.summary}" for spec in reader_specs().values())
    return f"Format of the data set; detected if not given. {readers}."


@click.command(cls=SensorsCommand)
@click.argument("dataset", type=click.Path(path_type=Path))
@run_option
@wait_option
@click.option("--format", "format_name", metavar="NAME", help=_format_help())
@click.option("--frames", type=FrameRange(), metavar="START:STOP:STEP", help="Frames to take; all if not given.")
@sensors_option("Depth sensors to take; all of the data set if not given.")
@click.option("--lossless", is_flag=True, help="Store colour as PNG: exact, but slower and five times as large as JPG.")
@click.option("--fix", is_flag=True, help="Mend what `uncle inspect` finds wrong, where it can be, and record it.")
@click.option("--force", is_flag=True, help="Go on although something is wrong.")
@overwrite_option
@click.pass_context
def command(
    ctx: click.Context,
    dataset: Path,
    run_path: Path,
    wait: bool,
    format_name: str | None,
    frames: slice | None,
    sensors: tuple[str, ...],
    lossless: bool,
    fix: bool,
    force: bool,
    overwrite: bool,
) -> None:
    """Read and check the recording in the folder DATASET and convert it into a run directory.

    Frames that cannot be read are skipped and reported; the manifest of the run lists them. A run that is up to date
    is left as it is.
    """
    from ..recon.core.events import Note
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.preprocess import preprocess_run

    on_event = listener(ctx)
    recording = open_dataset(dataset, format_name, on_event)
    summary = preprocess_run(
        recording,
        RunDirectory(run_path, wait),
        dataset=dataset,
        frames=frames,
        sensors=sensors or None,
        lossless=lossless,
        fix=fix,
        force=force,
        overwrite=overwrite,
        on_event=on_event,
    )
    if not summary.unchanged:
        rate = summary.frames / max(summary.seconds, 1e-3)
        names = ", ".join(summary.sensors)
        text = f"{summary.frames} frames of {recording.name} ({names}) in {run_path}, {rate:.0f} frames/s"
        on_event(Note(f"{text}; next: uncle map --run {run_path}"))
