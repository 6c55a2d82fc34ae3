"""The `eval` stage: score a run, a mesh file or a trajectory file against the ground truth."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from pathlib import Path

from ..core.errors import DataError
from ..core.events import Note, OnEvent, Warn, ignore
from ..core.mesh import Mesh, load_surface
from ..core.mesh_files.writer import require_writable_suffix
from ..evaluation.run_metrics import RunMetrics, score_run
from ..evaluation.surface_metrics import (
    DEFAULT_SETTINGS,
    EvaluationSettings,
    SurfaceMetrics,
    score_surface,
    write_error_mesh,
)
from ..evaluation.trajectory_files import load_trajectories
from ..evaluation.trajectory_metrics import TrajectoryMetrics, evaluate_trajectory
from ..evaluation.trajectory_pair import CameraPath
from ..evaluation.visibility import Visibility
from ..run.directory import RunDirectory
from ..run.lock import reading, writing
from ..run.manifest import config_hash
from ..run.meshes import load_reference_surface, load_run_mesh
from ..visualization.trajectory_charts import draw_camera_path
from .base import StageSummary

STAGE = "eval"

__all__ = ["EvaluationSettings", "EvaluationSummary", "evaluate_mesh_file", "evaluate_run", "evaluate_trajectory_file"]


@dataclass(frozen=True, kw_only=True)
class EvaluationSummary(StageSummary):
    """The scores of a run, also written to RUN/metrics.json."""

    metrics: RunMetrics


def evaluate_run(
    run: RunDirectory,
    settings: EvaluationSettings = DEFAULT_SETTINGS,
    *,
    error_mesh: Path | None = None,
    plots: Path | None = None,
    on_event: OnEvent = ignore,
) -> EvaluationSummary:
    """Score everything that `run` holds, write RUN/metrics.json and draw the trajectory.

    error_mesh   also write the mesh, coloured by its distance to the ground truth, to this file
    plots        folder of trajectory.png and drift.png; None: RUN/snapshots

    A run that cannot be written is scored, too; the scores are then only returned. Raises RunError if there is no run,
    nothing in it can be scored, its map or mesh is not of the present frames, or another process writes into it;
    DataError if an error mesh cannot be made.
    """
    started = time.time()
    if error_mesh is not None:
        require_writable_suffix(error_mesh)
    with writing(run, STAGE, on_event, may_be_read_only=True) as is_writable:
        if is_writable:
            metrics = _score_and_save(run, settings, on_event)
        else:
            on_event(Warn(f"{run.root} is read-only: the scores are not written there"))
            with reading(run):
                metrics = score_run(run, settings, on_event)
        if error_mesh is not None:
            mesh_metrics = metrics.surface.mesh if metrics.surface is not None else None
            write_error_mesh(error_mesh, load_run_mesh(run), load_reference_surface(run), mesh_metrics)
        charts = plots or (run.snapshots_path if is_writable else None)
        if charts is not None and (metrics.trajectory is not None or metrics.tracking is not None):
            try:
                _draw(CameraPath.of_run(run), charts, on_event)
            except DataError as error:
                on_event(Warn(f"the trajectory is not drawn: {error}"))
    return EvaluationSummary(metrics=metrics, seconds=time.time() - started)


def _score_and_save(run: RunDirectory, settings: EvaluationSettings, on_event: OnEvent) -> RunMetrics:
    started = time.time()
    metrics = score_run(run, settings, on_event)
    run.begin_stage(STAGE)
    metrics.save(run.metrics_path)
    digest = config_hash(asdict(settings))
    run.finish_stage(STAGE, digest, started, {}, inputs=("preprocess", "map", "mesh"))
    return metrics


def evaluate_mesh_file(
    mesh_path: Path,
    reference_path: Path,
    settings: EvaluationSettings = DEFAULT_SETTINGS,
    *,
    cull: RunDirectory | None = None,
    error_mesh: Path | None = None,
    on_event: OnEvent = ignore,
) -> SurfaceMetrics:
    """Score a mesh file against another one or a point cloud; with `cull` only what the cameras of that run saw.

    Raises DataError, RunError.
    """
    if error_mesh is not None:
        require_writable_suffix(error_mesh)
    mesh = Mesh.load(mesh_path, on_event, cull.load_manifest().world_offset_m if cull is not None else None)
    reference = load_surface(reference_path, on_event, mesh.offset_m)
    visibility = Visibility.of_run(cull) if cull is not None else None
    metrics = score_surface(mesh, reference, settings, visibility)
    if error_mesh is not None:
        write_error_mesh(error_mesh, mesh, reference, metrics.mesh)
    return metrics


def evaluate_trajectory_file(
    estimate: Path, reference: Path, *, plots: Path | None = None, on_event: OnEvent = ignore
) -> TrajectoryMetrics:
    """Score one file of poses against another; with `plots` also draw both into that folder. Raises DataError."""
    estimated, true = load_trajectories(estimate, reference, on_event)
    metrics = evaluate_trajectory(estimated, true)
    if plots is not None:
        _draw(CameraPath(estimated, true), plots, on_event)
    return metrics


def _draw(path: CameraPath, folder: Path, on_event: OnEvent) -> None:
    charts = draw_camera_path(path, folder)
    on_event(Note(f"drawn: {', '.join(map(str, charts))}"))
