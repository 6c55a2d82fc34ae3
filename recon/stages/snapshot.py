"""`uncle snapshot` as two functions: the pictures of a mesh file, and those of a run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..core.events import OnEvent, Warn, ignore
from ..core.mesh import Mesh
from ..run.directory import RunDirectory
from ..visualization.mesh_pictures import draw_mesh, load_reference, load_run_mesh, snapshot_views
from ..visualization.sensor_pictures import draw_sensors
from ..visualization.views import DEFAULT_SIZE


def snapshot_file(
    path: Path,
    out: Path,
    run: RunDirectory | None = None,
    reference: Path | None = None,
    *,
    modes: Sequence[str] | None = None,
    size: tuple[int, int] = DEFAULT_SIZE,
    renderer: str = "auto",
    on_event: OnEvent = ignore,
) -> list[Path]:
    """Draw the mesh file at `path`, seen from the cameras of `run` where one is given; returns the sheets in `out`.

    Raises DataError, RunError, DependencyError.
    """
    mesh = Mesh.load(path)
    truth = Mesh.load(reference) if reference is not None else None
    views = snapshot_views(mesh, run, size)
    return [snapshot.save(out) for snapshot in draw_mesh(mesh, views, modes, truth, renderer, on_event)]


def snapshot_run(
    run: RunDirectory,
    out: Path,
    reference: Path | None = None,
    *,
    modes: Sequence[str] | None = None,
    size: tuple[int, int] = DEFAULT_SIZE,
    renderer: str = "auto",
    on_event: OnEvent = ignore,
) -> list[Path]:
    """Draw the mesh of a run and what its sensors say; returns the sheets in `out`.

    Raises RunError (no run, no mesh), DataError, DependencyError.
    """
    mesh = load_run_mesh(run)
    truth = Mesh.load(reference) if reference is not None else load_reference(run)
    named = run.manifest.reference_mesh
    if named and truth is None:
        on_event(Warn(f"the data set's ground-truth mesh {named} is gone; no error picture"))
    views = snapshot_views(mesh, run, size)
    sheets = [snapshot.save(out) for snapshot in draw_mesh(mesh, views, modes, truth, renderer, on_event)]
    return sheets + ([] if modes else draw_sensors(run, out, on_event))
