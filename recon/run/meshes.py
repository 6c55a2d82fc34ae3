"""The meshes that belong to a run: its own, and the ground truth of its data set."""

from __future__ import annotations

from pathlib import Path

from ..core.errors import DataError, RunError
from ..core.events import OnEvent, ignore
from ..core.mesh import Mesh, PointCloud, load_surface
from .directory import RunDirectory


def load_run_mesh(run: RunDirectory) -> Mesh:
    """RUN/mesh.ply. Raises RunError if there is no run, or no mesh of its map; DataError if the file is broken."""
    run.require_current("mesh")
    if not run.mesh_path.is_file():
        raise RunError(f"{run.root} has no mesh; make it with `uncle mesh --run {run.root}`")
    return Mesh.load(run.mesh_path, offset_m=run.load_manifest().world_offset_m)


def load_reference_mesh(run: RunDirectory) -> Mesh:
    """The ground-truth mesh of the data set. Raises DataError if there is none, or it is a point cloud."""
    return Mesh.load(_reference_path(run), offset_m=run.load_manifest().world_offset_m)


def load_reference_surface(run: RunDirectory, on_event: OnEvent = ignore) -> Mesh | PointCloud:
    """The ground-truth mesh or point cloud of the data set. Raises DataError if there is none or the file is gone."""
    return load_surface(_reference_path(run), on_event, run.load_manifest().world_offset_m)


def _reference_path(run: RunDirectory) -> Path:
    reference = run.load_manifest().reference_mesh
    if reference is None:
        raise DataError("the data set has no ground-truth mesh")
    if not Path(reference).is_file():
        raise DataError(f"the ground-truth mesh {reference} no longer exists")
    return Path(reference)


def has_reference_mesh(run: RunDirectory) -> bool:
    """Whether the data set names a ground-truth mesh and the file exists."""
    reference = run.load_manifest().reference_mesh
    return reference is not None and Path(reference).is_file()
