"""The `snapshot` stage: pictures of a mesh file, or of a run and its sensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..core.errors import DataError
from ..core.events import OnEvent, Warn, ignore
from ..core.mesh import Mesh
from ..run.directory import RunDirectory
from ..run.lock import writing_to
from ..run.meshes import load_reference_mesh, load_run_mesh
from ..visualization.mesh_pictures import draw_mesh, snapshot_views
from ..visualization.sensor_pictures import draw_sensors
from ..visualization.views import DEFAULT_SIZE

STAGE = "snapshot"


@dataclass(frozen=True)
class SnapshotSettings:
    """What to draw, and how.

    modes     pictures to draw (`mesh_pictures.MODES`); None: all that the mesh has data for
    size      width and height of one picture, pixels
    renderer  "offscreen" (Open3D, needs a driver), "raycast" (CPU), or "auto": the first that works
    """

    modes: Sequence[str] | None = None
    size: tuple[int, int] = DEFAULT_SIZE
    renderer: str = "auto"


def snapshot_file(
    path: Path,
    out: Path,
    run: RunDirectory | None = None,
    reference: Path | None = None,
    *,
    settings: SnapshotSettings = SnapshotSettings(),
    on_event: OnEvent = ignore,
) -> list[Path]:
    """Draw the mesh file `path`, seen from the cameras of `run` where one is given; returns the picture files in `out`.

    `reference` is the ground-truth mesh of the error picture. Raises DataError, RunError, DependencyError.
    """
    mesh = Mesh.load(path, offset_m=run.load_manifest().world_offset_m if run is not None else None)
    truth = Mesh.load(reference, offset_m=mesh.offset_m) if reference is not None else None
    return _draw(mesh, out, run, truth, settings, on_event)


def snapshot_run(
    run: RunDirectory,
    out: Path,
    reference: Path | None = None,
    *,
    settings: SnapshotSettings = SnapshotSettings(),
    on_event: OnEvent = ignore,
) -> list[Path]:
    """Draw the mesh of a run and, unless `settings` names modes, its sensors; returns the picture files in `out`.

    `reference` replaces the ground-truth mesh of the data set. Raises RunError (no run, no mesh of its present frames,
    in use by another process), DataError, DependencyError.
    """
    with writing_to(run, out, STAGE, on_event):
        run.require_current("map")
        mesh = load_run_mesh(run)
        at = mesh.offset_m
        truth = Mesh.load(reference, offset_m=at) if reference is not None else _reference_of_data_set(run, on_event)
        sheets = _draw(mesh, out, run, truth, settings, on_event)
        return sheets + ([] if settings.modes else draw_sensors(run, out, on_event))


def _draw(
    mesh: Mesh, out: Path, run: RunDirectory | None, truth: Mesh | None, settings: SnapshotSettings, on_event: OnEvent
) -> list[Path]:
    views = snapshot_views(mesh, run, settings.size)
    snapshots = draw_mesh(mesh, views, settings.modes, truth, settings.renderer, on_event)
    return [snapshot.save(out) for snapshot in snapshots]


def _reference_of_data_set(run: RunDirectory, on_event: OnEvent) -> Mesh | None:
    """None where the data set has no ground-truth mesh; a warning where it has named one that is gone."""
    if run.load_manifest().reference_mesh is None:
        return None
    try:
        return load_reference_mesh(run)
    except DataError as error:
        on_event(Warn(f"no error picture: {error}"))
        return None
