"""The `mesh` stage: extract the surface of a finished map."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from ..core.events import Note, OnEvent, ignore
from ..core.mesh_files.writer import require_writable_suffix
from ..methods.registry import method_specs
from ..run.directory import RunDirectory
from ..run.lock import writing_to
from ..run.manifest import config_hash
from ..volume.mesh_extraction import make_mesh
from .base import StageSummary
from .map import load_field

STAGE = "mesh"


@dataclass(frozen=True, kw_only=True)
class MeshSummary(StageSummary):
    """Where the mesh is, and its size; 0 vertices and faces if it was kept."""

    path: Path
    vertices: int = 0
    faces: int = 0


def mesh_run(
    run: RunDirectory, *, voxel_size_m: float | None = None, clean: bool | None = None,
    max_sigma_m: float | None = None, out: Path | None = None, overwrite: bool = False, on_event: OnEvent = ignore,
) -> MeshSummary:  # fmt: skip
    """Write the mesh of a finished map to `out` (default RUN/mesh.ply), in the format of its suffix.

    voxel_size_m   cell size of marching cubes; None: that of the map
    clean          keep only what the cameras saw and drop small loose parts; None: as the method has it
                   (`MethodSpec.clean_mesh`)
    max_sigma_m    leave out vertices with a larger sigma

    Raises RunError if there is no map of the present frames, another process writes into the run, or
    (before any work) there is no such format; DataError.
    """
    if out is not None:
        require_writable_suffix(out)
    path = out or run.mesh_path
    with writing_to(run, path, STAGE, on_event):
        return _extract(run, path, voxel_size_m, clean, max_sigma_m, overwrite, on_event)


def _extract(
    run: RunDirectory, path: Path, voxel_size_m: float | None, clean: bool | None, max_sigma_m: float | None,
    overwrite: bool, on_event: OnEvent,
) -> MeshSummary:  # fmt: skip
    map_record = run.require_stage("map")
    if clean is None:
        spec = method_specs().get(str(map_record.facts.get("method")))  # None: its package is not installed
        clean = spec is None or spec.clean_mesh
    digest = config_hash(voxel_size_m, clean, max_sigma_m, map_record.config_hash, map_record.finished)
    is_result = path.resolve() == run.mesh_path.resolve()
    if is_result and run.is_current(STAGE, digest) and path.exists() and not overwrite:
        return MeshSummary(path=path, unchanged=True)
    started = time.time()
    poses = run.load_trajectory().T_world_camera
    mesh = make_mesh(load_field(run), run.load_camera(), list(poses), voxel_size_m, clean, max_sigma_m, on_event)
    mesh = replace(mesh, offset_m=run.load_manifest().world_offset_m)
    if is_result:
        run.begin_stage(STAGE)
    mesh.save(path)
    if mesh.sigma is not None and path.suffix.lower() != ".ply":
        on_event(Note(f"{path} holds no sigma of its vertices: only PLY can"))
    if is_result:
        facts = {"voxel_size_m": voxel_size_m, "clean": clean, "max_sigma_m": max_sigma_m}
        facts |= {"vertices": len(mesh.vertices), "faces": len(mesh.faces)}
        run.finish_stage(STAGE, digest, started, facts, inputs=("map",))
    return MeshSummary(
        path=path, vertices=len(mesh.vertices), faces=len(mesh.faces), seconds=time.time() - started
    )  # fmt: skip
