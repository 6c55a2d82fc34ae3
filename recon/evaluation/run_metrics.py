"""Everything of a run that can be scored, and the reasons for what cannot."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from ..core.errors import DataError, RunError, UncleError
from ..core.events import Note, OnEvent, ignore, track_progress
from ..core.files import write_text
from ..core.frame import GROUND_TRUTH_SENSOR
from ..core.json_values import to_plain
from ..core.mesh import Mesh
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.manifest import Manifest
from .color_metrics import HeldOutColor, held_out_color
from .depth_metrics import HeldOutDepth, NovelViewDepth, ViewSettings, held_out_depth, novel_view_depth
from .mesh_metrics import CompletenessTarget, MeshMetrics, Protocol, color_by_distance, evaluate_mesh, moved
from .run_trajectory import score_tracking, score_trajectory
from .tracking_metrics import TrackingMetrics
from .trajectory_metrics import TrajectoryMetrics
from .uncertainty_calibration import UncertaintyMetrics, evaluate_uncertainty
from .vertex_sigma_metrics import VertexSigmaMetrics, evaluate_vertex_sigma
from .visibility import Visibility

UNCERTAINTY_READINGS = 500_000  # per sensor, drawn evenly from the frames
GIVEN_POSES_M = 1e-6  # a trajectory this close to the truth was not estimated

T = TypeVar("T")


@dataclass(frozen=True)
class EvalSettings:
    """What a user may choose; the defaults are those of the command line. `icp` None leaves it to the protocol."""

    thresholds_m: tuple[float, ...] = (0.05, 0.02)
    samples: int = 250_000
    seed: int = 0
    icp: bool | None = None
    protocol: Protocol = "standard"
    completeness_to: CompletenessTarget = "samples"
    views: int | None = None  # None: 100, or the paper's 1000; 0: no depth from new views

    @property
    def view_settings(self) -> ViewSettings:
        default = 1000 if self.protocol == "paper" else 100
        return ViewSettings(default if self.views is None else self.views, self.protocol, self.seed)


@dataclass(frozen=True)
class SurfaceMetrics:
    """Scores of one mesh against one reference. `skipped`: part -> why it was not scored."""

    mesh: MeshMetrics
    novel_views: NovelViewDepth | None
    vertex_sigma: VertexSigmaMetrics | None  # of the vertices
    skipped: dict[str, str]


@dataclass(frozen=True)
class RunMetrics:
    """Scores of a run; what is None or missing stands in `skipped` with the reason. Dictionaries are by sensor."""

    run: str
    surface: SurfaceMetrics | None
    trajectory: TrajectoryMetrics | None
    tracking: TrackingMetrics | None  # None, without a reason, where the poses were given
    held_out: dict[str, HeldOutDepth]
    held_out_color: HeldOutColor | None
    uncertainty: dict[str, UncertaintyMetrics]
    skipped: dict[str, str]
    notes: tuple[str, ...]
    settings: EvalSettings

    def save(self, path: Path) -> None:
        """Write JSON: SI units, ratios 0..1. Raises RunError."""
        write_text(path, json.dumps(to_plain(self), indent=2, sort_keys=True) + "\n")


def score_surface(
    mesh: Mesh, reference: Mesh, settings: EvalSettings, cull: Visibility | None = None
) -> SurfaceMetrics:
    """Score `mesh` against `reference`; with `cull` only what the cameras saw. Raises DataError."""
    visible = cull.seen if cull is not None else None
    seen_reference = cull.reference_points(reference) if cull is not None else None
    metrics = evaluate_mesh(
        mesh,
        reference,
        thresholds_m=settings.thresholds_m,
        samples=settings.samples,
        seed=settings.seed,
        icp=settings.icp,
        protocol=settings.protocol,
        completeness_to=settings.completeness_to,
        visible=visible,
        seen_reference=seen_reference,
    )
    skipped: dict[str, str] = {}
    aligned = moved(mesh, np.array(metrics.T_reference_mesh)) if metrics.settings.icp else mesh
    novel_views = None
    if settings.view_settings.views == 0:
        skipped["novel_views"] = "no views were asked for"
    else:
        novel_views = _attempt(
            "novel_views", skipped, lambda: novel_view_depth(aligned, reference, settings.view_settings, seen_reference)
        )
    vertex_sigma = _attempt("vertex_sigma", skipped, lambda: evaluate_vertex_sigma(aligned, reference, visible))
    return SurfaceMetrics(metrics, novel_views, vertex_sigma, skipped)


def evaluate_run(run: RunDirectory, settings: EvalSettings | None = None, on_event: OnEvent = ignore) -> RunMetrics:
    """Score what `run` holds: mesh, trajectory, depth and colour of held-out frames, uncertainty.

    Raises RunError if there is no run, or nothing in it can be scored.
    """
    settings = settings or EvalSettings()
    manifest, frames = run.manifest, RunFrames(run)
    skipped: dict[str, str] = {}
    on_event(Note("scoring the mesh and the trajectory"))
    surface = _attempt("mesh", skipped, lambda: _score_run_mesh(run, manifest, settings))
    trajectory = _attempt("trajectory", skipped, lambda: score_trajectory(run))
    tracking = _attempt("tracking", skipped, lambda: score_tracking(run))
    held_out, colors = {}, None
    if indices := _attempt("held_out", skipped, lambda: _held_out_indices(manifest, frames)):
        held_out = (
            _attempt("held_out", skipped, lambda: _score_held_out(run, manifest, frames, indices, on_event)) or {}
        )
        colors = _attempt("held_out_color", skipped, lambda: _score_held_out_color(run, frames, indices, on_event))
    uncertainty = {}
    for sensor in _sensors_with_beta(run, manifest, skipped):
        scored = _attempt(
            f"uncertainty/{sensor}", skipped, lambda s=sensor: score_uncertainty(frames, s, settings.seed, on_event)
        )
        if scored is not None:
            uncertainty[sensor] = scored
    if not (surface or trajectory or tracking or held_out or colors or uncertainty):
        reasons = "; ".join(f"{part}: {reason}" for part, reason in skipped.items())
        raise RunError(f"nothing in {run.root} can be scored ({reasons})")
    if surface is not None:
        skipped |= surface.skipped
    notes = _notes(surface, trajectory, tracking)
    return RunMetrics(
        str(run.root), surface, trajectory, tracking, held_out, colors, uncertainty, skipped, notes, settings
    )


def write_error_mesh(path: Path, mesh: Mesh, reference: Mesh, metrics: MeshMetrics | None) -> None:
    """Write `mesh`, aligned as it was scored, coloured by its distance to `reference` up to the largest threshold.

    Raises DataError if the mesh was not scored, RunError if the file cannot be written.
    """
    if metrics is None:
        raise DataError("the mesh was not scored, so there is no error to colour it by")
    aligned = moved(mesh, np.array(metrics.T_reference_mesh)) if metrics.settings.icp else mesh
    limit_m = max(score.threshold_m for score in metrics.scores)
    color_by_distance(aligned, reference, limit_m).save(path)


def load_reference(manifest: Manifest) -> Mesh:
    """The ground-truth mesh of the data set. Raises DataError if there is none, or no longer."""
    if manifest.reference_mesh is None:
        raise DataError("the data set has no ground-truth mesh")
    if not Path(manifest.reference_mesh).is_file():
        raise DataError(f"the ground-truth mesh {manifest.reference_mesh} is no longer there")
    return Mesh.load(Path(manifest.reference_mesh))


def _attempt(part: str, skipped: dict[str, str], score: Callable[[], T]) -> T | None:
    try:
        return score()
    except UncleError as error:
        skipped[part] = str(error)
        return None


def _score_run_mesh(run: RunDirectory, manifest: Manifest, settings: EvalSettings) -> SurfaceMetrics:
    reference = load_reference(manifest)
    return score_surface(_run_mesh(run), reference, settings, Visibility.of_run(run))


def _run_mesh(run: RunDirectory) -> Mesh:
    if not run.mesh_path.is_file():
        raise DataError(f"there is no mesh yet; run `uncle mesh --run {run.root}`")
    return Mesh.load(run.mesh_path)


def _score_held_out(
    run: RunDirectory, manifest: Manifest, frames: RunFrames, indices: list[int], on_event: OnEvent
) -> dict[str, HeldOutDepth]:
    """By sensor; the ground truth alone where the run has it."""
    mesh = _run_mesh(run)
    true = GROUND_TRUTH_SENSOR in manifest.sensors
    mapped = manifest.stages["map"].facts.get("sensors") or manifest.sensors

    def views(sensor: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for index in track_progress(indices, len(indices), f"held-out depth, {sensor}", on_event):
            yield frames.pose(index), frames.depth(index, sensor).numpy()

    sensors = (GROUND_TRUTH_SENSOR,) if true else mapped
    return {sensor: held_out_depth(mesh, frames.camera, views(sensor), sensor) for sensor in sensors}


def _score_held_out_color(run: RunDirectory, frames: RunFrames, indices: list[int], on_event: OnEvent) -> HeldOutColor:
    shown = track_progress(indices, len(indices), "held-out colour", on_event)
    return held_out_color(_run_mesh(run), frames.camera, ((frames.pose(i), frames.color(i).numpy()) for i in shown))


def _held_out_indices(manifest: Manifest, frames: RunFrames) -> list[int]:
    record = manifest.stages.get("map")
    listed = record.facts.get("held_out") if record is not None else None
    if not listed:
        raise DataError("no frames were held out of the map")
    indices = [int(i) for i in listed if 0 <= int(i) < len(frames) and frames.pose(int(i)) is not None]
    if not indices:
        raise DataError("none of the held-out frames has a pose")
    return indices


def _sensors_with_beta(run: RunDirectory, manifest: Manifest, skipped: dict[str, str]) -> list[str]:
    sensors = [s for s in manifest.sensors if s != GROUND_TRUTH_SENSOR and run.beta_path(s, 0).parent.is_dir()]
    if not sensors:
        skipped["uncertainty"] = "there are no maps of the uncertainty (beta)"
        return []
    if GROUND_TRUTH_SENSOR not in manifest.sensors:
        skipped["uncertainty"] = f"the run has no ground-truth depth (a sensor named {GROUND_TRUTH_SENSOR})"
        return []
    return sensors


def score_uncertainty(frames: RunFrames, sensor: str, seed: int, on_event: OnEvent) -> UncertaintyMetrics:
    """Readings with a beta and a true depth at their pixel, the same number from each frame."""
    indices = [index for index in range(len(frames)) if frames.run.beta_path(sensor, index).is_file()]
    rng = np.random.default_rng(seed)
    quota = -(-UNCERTAINTY_READINGS // max(1, len(indices)))
    depths, errors, betas = [np.zeros(0)], [np.zeros(0)], [np.zeros(0)]
    for index in track_progress(indices, len(indices), f"uncertainty, {sensor}", on_event):
        depth, true, beta = (
            image.numpy().ravel()
            for image in (
                frames.depth(index, sensor), frames.depth(index, GROUND_TRUTH_SENSOR), frames.beta(index, sensor)
            )
        )  # fmt: skip
        valid = np.flatnonzero((depth > 0) & (true > 0) & (beta > 0))
        chosen = rng.permutation(valid)[:quota]
        depths.append(depth[chosen])
        errors.append(depth[chosen] - true[chosen])
        betas.append(beta[chosen])
    error, beta = np.concatenate(errors), np.concatenate(betas)
    if len(error) == 0:
        raise DataError("no reading has both a beta and a true depth")
    mapped = frames.run.manifest.stages.get("map")
    stated = mapped.facts.get("error_quantiles_in_beta", {}).get(sensor) if mapped else None
    return evaluate_uncertainty(
        error, beta, np.concatenate(depths), intervals=stated, max_readings=UNCERTAINTY_READINGS, seed=seed
    )


def _notes(
    surface: SurfaceMetrics | None, trajectory: TrajectoryMetrics | None, tracking: TrackingMetrics | None
) -> tuple[str, ...]:
    notes = []
    if surface is not None and surface.mesh.note:
        notes.append(surface.mesh.note)
    if trajectory is not None and tracking is None and trajectory.ate_m.max < GIVEN_POSES_M:
        notes.append("the camera poses were given, not estimated: the trajectory errors say nothing")
    return tuple(notes)
