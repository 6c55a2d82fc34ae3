"""`uncle mesh`: extract the surface of a finished map."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener
from .options import overwrite_option, run_option, wait_option


@click.command("mesh")
@run_option
@wait_option
@click.option("--voxel", type=click.FloatRange(0.001, 0.5), default=None, metavar="METRES",
              help="Cell size of the mesh. Default: that of the map.")  # fmt: skip
@click.option("--clean/--no-clean", default=None,
              help="Keep only what the cameras saw, without floaters. "
                   "Default: on, but off for the plain tsdf baseline.")  # fmt: skip
@click.option("--max-sigma", type=click.FloatRange(min=0.0, min_open=True), default=None, metavar="METRES",
              help="Leave out vertices whose 1-sigma error is larger than this.")  # fmt: skip
@click.option("--min-confidence", type=click.FloatRange(min=0.0, min_open=True), hidden=True)  # its former name
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default=None,
              help="PLY, OBJ, STL, OFF, glTF or GLB file. Default: RUN/mesh.ply.")  # fmt: skip
@overwrite_option
@click.pass_context
def command(
    ctx: click.Context, run_path: Path, wait: bool, voxel: float | None, clean: bool | None, max_sigma: float | None,
    min_confidence: float | None, out: Path | None, overwrite: bool,
) -> None:  # fmt: skip
    """Extract the surface of a finished map: colour, and in PLY sigma (expected error, metres), per vertex."""
    from ..recon.core.events import Note
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.mesh import mesh_run

    say = listener(ctx)
    summary = mesh_run(
        RunDirectory(run_path, wait), voxel_size_m=voxel, clean=clean, max_sigma_m=max_sigma or min_confidence,
        out=out, overwrite=overwrite, on_event=say,
    )  # fmt: skip
    if summary.unchanged:
        say(Note(f"{summary.path} is done and unchanged; --overwrite redoes it."))
        return
    size = f"{summary.vertices} vertices, {summary.faces} triangles"
    say(Note(f"Wrote {summary.path}: {size}. Next: uncle eval --run {run_path}"))
