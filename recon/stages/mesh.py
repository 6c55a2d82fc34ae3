"""The `mesh` stage of a run."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from ..core.events import OnEvent, ignore
from ..core.trajectory import Trajectory
from ..methods.registry import method_specs
from ..run.directory import RunDirectory
from ..run.manifest import config_hash
from ..volume.mesh_extraction import make_mesh
from .map import load_field

STAGE = "mesh"


@dataclass(frozen=True)
class MeshSummary:
    """Where the mesh is, and its size (0 if it was already there)."""

    path: Path
    vertices: int
    faces: int
    unchanged: bool = False


def mesh_run(
    run: RunDirectory, *, voxel_size_m: float | None = None, clean: bool | None = None,
    max_sigma_m: float | None = None, out: Path | None = None, overwrite: bool = False, on_event: OnEvent = ignore,
) -> MeshSummary:  # fmt: skip
    """Write the mesh of a finished map to `out` (default RUN/mesh.ply). Raises RunError, DataError.

    Without `clean` the method decides (`MethodSpec.clean_mesh`).
    """
    mapped = run.require_stage("map")
    if clean is None:
        spec = method_specs().get(str(mapped.facts.get("method")))  # None: the package of the method is gone
        clean = spec is None or spec.clean_mesh
    digest = config_hash(voxel_size_m, clean, max_sigma_m, mapped.config_hash, mapped.finished)
    path = out or run.mesh_path
    if out is None and run.is_current(STAGE, digest) and path.exists() and not overwrite:
        return MeshSummary(path, 0, 0, unchanged=True)
    started = time.time()
    poses = Trajectory.load(run.trajectory_path).T_world_camera
    mesh = make_mesh(load_field(run), run.load_camera(), list(poses), voxel_size_m, clean, max_sigma_m, on_event)
    mesh.save(path)
    if out is None:
        facts = {"voxel_size_m": voxel_size_m, "clean": clean, "max_sigma_m": max_sigma_m}
        facts |= {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
        run.finish_stage(STAGE, digest, started, facts)
    return MeshSummary(path, len(mesh.vertices), len(mesh.faces))
