"""`uncle snapshot`: pictures of a mesh or of a run."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener
from .options import run_option, wait_option

MODES = ["shaded", "color", "sigma", "error"]


class SizeType(click.ParamType[tuple[int, int]]):
    """Picture size `WIDTHxHEIGHT` in pixels."""

    name = "WxH"

    def convert(
        self, value: str | tuple[int, int], param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Parse `WIDTHxHEIGHT`. Raises BadParameter."""
        if isinstance(value, tuple):
            return value
        words = value.lower().split("x")
        if len(words) != 2 or not all(word.isdecimal() for word in words):
            self.fail(f"{value!r} is no size; write WIDTHxHEIGHT, such as 960x720", param, ctx)
        width, height = (int(word) for word in words)
        if not (16 <= width <= 8192 and 16 <= height <= 8192):
            self.fail(f"{value!r} is out of range; each side has 16 to 8192 pixels", param, ctx)
        return width, height


@click.command("snapshot")
@click.argument("mesh", required=False, type=click.Path(path_type=Path), metavar="[MESH|RUN]")
@run_option
@wait_option
@click.option("--gt", "reference", type=click.Path(path_type=Path, dir_okay=False), help="Ground-truth mesh.")
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False),
    help="Folder for the pictures.  [default: RUN/snapshots, or MESH_snapshots beside a mesh]",
)  # fmt: skip
@click.option("--mode", "modes", multiple=True, type=click.Choice(MODES), help="Repeatable.  [default: all there are]")
@click.option("--size", type=SizeType(), default="960x720", show_default=True, help="Size of one picture.")
@click.option(
    "--renderer", type=click.Choice(["auto", "offscreen", "raycast"]), default="auto", show_default=True,
    help="Open3D's OffscreenRenderer (needs a driver) or the CPU ray caster (runs everywhere).",
)  # fmt: skip
@click.pass_context
def command(
    ctx: click.Context,
    mesh: Path | None,
    run_path: Path,
    wait: bool,
    reference: Path | None,
    out: Path | None,
    modes: tuple[str, ...],
    size: tuple[int, int],
    renderer: str,
) -> None:
    """Draw pictures of a mesh, or of a run and its sensors.

    Without MESH, or with a run directory in its place, the mesh of the run is drawn from the run's cameras, and also
    the depth and beta maps of each sensor. The path of every picture is printed.
    """
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.snapshot import SnapshotSettings, snapshot_file, snapshot_run

    settings, on_event = SnapshotSettings(modes or None, size, renderer), listener(ctx)
    run_is_given = ctx.get_parameter_source("run_path") is click.core.ParameterSource.COMMANDLINE
    if mesh is None or mesh.is_dir():
        run = RunDirectory(mesh or run_path, wait)
        sheets = snapshot_run(run, out or run.snapshots_path, reference, settings=settings, on_event=on_event)
    else:
        folder = out or mesh.with_name(f"{mesh.stem}_snapshots")
        cameras = RunDirectory(run_path) if run_is_given else None
        sheets = snapshot_file(mesh, folder, cameras, reference, settings=settings, on_event=on_event)
    for sheet in sheets:
        click.echo(str(sheet))
