"""All scores of a run, and the reasons for what could not be scored."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ..core.errors import DataError, RunError
from ..core.events import Note, OnEvent, ignore, track_progress
from ..core.files import write_text
from ..core.frame import GROUND_TRUTH_SENSOR
from ..core.json_values import to_plain
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.manifest import Manifest
from ..run.meshes import load_reference_surface, load_run_mesh
from .color_metrics import HeldOutColor, held_out_color
from .depth_metrics import HeldOutDepth, held_out_depth
from .run_trajectory import score_tracking, score_trajectory
from .sensor_uncertainty import score_uncertainty
from .surface_metrics import DEFAULT_SETTINGS, EvaluationSettings, SurfaceMetrics, score_or_skip, score_surface
from .tracking_metrics import TrackingMetrics
from .trajectory_metrics import TrajectoryMetrics
from .uncertainty_calibration import UncertaintyMetrics
from .visibility import Visibility

MAX_GIVEN_POSE_ERROR_M = 1e-6  # a trajectory this close to the truth was given, not estimated


@dataclass(frozen=True)
class RunMetrics:
    """Scores of a run; dictionaries are by sensor.

    What is None or missing is listed in `skipped` with the reason, except `tracking` where the poses were given.
    """

    run: str
    surface: SurfaceMetrics | None
    trajectory: TrajectoryMetrics | None
    tracking: TrackingMetrics | None
    held_out: dict[str, HeldOutDepth]
    held_out_color: HeldOutColor | None
    uncertainty: dict[str, UncertaintyMetrics]
    skipped: dict[str, str]
    notes: tuple[str, ...]
    settings: EvaluationSettings

    def save(self, path: Path) -> None:
        """Write JSON: SI units, ratios 0..1. Raises RunError."""
        write_text(path, json.dumps(to_plain(self), indent=2, sort_keys=True) + "\n")


def score_run(
    run: RunDirectory, settings: EvaluationSettings = DEFAULT_SETTINGS, on_event: OnEvent = ignore
) -> RunMetrics:
    """Score what `run` holds: mesh, trajectory, tracking record, held-out frames, uncertainty.

    Raises RunError if there is no run, nothing in it can be scored, or its map or mesh is not of the present frames.
    """
    run.require_current("map", "mesh")
    manifest, frames = run.load_manifest(), RunFrames(run)
    skipped: dict[str, str] = {}
    on_event(Note("scoring the mesh and the trajectory"))
    surface = score_or_skip("mesh", skipped, lambda: _score_run_mesh(run, settings, on_event))
    trajectory = score_or_skip("trajectory", skipped, lambda: score_trajectory(run))
    tracking = score_or_skip("tracking", skipped, lambda: score_tracking(run))
    held_out, color = _score_held_out(run, manifest, frames, skipped, on_event)
    uncertainty = _score_uncertainties(run, manifest, frames, skipped, settings.seed, on_event)
    if not (surface or trajectory or tracking or held_out or color or uncertainty):
        reasons = "; ".join(f"{part}: {reason}" for part, reason in skipped.items())
        raise RunError(f"nothing in {run.root} can be scored ({reasons})")
    if surface is not None:
        skipped |= surface.skipped
    return RunMetrics(
        run=str(run.root),
        surface=surface,
        trajectory=trajectory,
        tracking=tracking,
        held_out=held_out,
        held_out_color=color,
        uncertainty=uncertainty,
        skipped=skipped,
        notes=_notes(surface, trajectory, tracking),
        settings=settings,
    )


def _score_run_mesh(run: RunDirectory, settings: EvaluationSettings, on_event: OnEvent) -> SurfaceMetrics:
    reference = load_reference_surface(run, on_event)
    return score_surface(load_run_mesh(run), reference, settings, Visibility.of_run(run))


def _score_held_out(
    run: RunDirectory, manifest: Manifest, frames: RunFrames, skipped: dict[str, str], on_event: OnEvent
) -> tuple[dict[str, HeldOutDepth], HeldOutColor | None]:
    """Depth by sensor and colour of the frames that were held out of the map."""
    indices = score_or_skip("held_out", skipped, lambda: _held_out_indices(manifest, frames))
    if not indices:
        return {}, None
    depth = score_or_skip(
        "held_out", skipped, lambda: _score_held_out_depth(run, manifest, frames, indices, on_event)
    )  # fmt: skip
    color = score_or_skip("held_out_color", skipped, lambda: _score_held_out_color(run, frames, indices, on_event))
    return depth or {}, color


def _score_held_out_depth(
    run: RunDirectory, manifest: Manifest, frames: RunFrames, indices: list[int], on_event: OnEvent
) -> dict[str, HeldOutDepth]:
    """By sensor: the ground truth alone where the run has it, else every mapped sensor."""
    mesh = load_run_mesh(run)
    mapped = manifest.stages["map"].facts.get("sensors") or manifest.sensors

    def views(sensor: str) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        for index in track_progress(indices, len(indices), f"held-out depth, {sensor}", on_event):
            yield frames.known_pose(index), frames.depth(index, sensor).numpy()

    sensors = (GROUND_TRUTH_SENSOR,) if GROUND_TRUTH_SENSOR in manifest.sensors else mapped
    return {sensor: held_out_depth(mesh, frames.camera, views(sensor), sensor) for sensor in sensors}


def _score_held_out_color(run: RunDirectory, frames: RunFrames, indices: list[int], on_event: OnEvent) -> HeldOutColor:
    progress = track_progress(indices, len(indices), "held-out colour", on_event)
    views = ((frames.known_pose(index), frames.color(index).numpy()) for index in progress)
    return held_out_color(load_run_mesh(run), frames.camera, views)


def _held_out_indices(manifest: Manifest, frames: RunFrames) -> list[int]:
    record = manifest.stages.get("map")
    listed = record.facts.get("held_out") if record is not None else None
    if not listed:
        raise DataError("no frames were held out of the map (`uncle map --hold-out N`)")
    indices = [int(i) for i in listed if 0 <= int(i) < len(frames) and frames.pose(int(i)) is not None]
    if not indices:
        raise DataError("none of the held-out frames has a pose")
    return indices


def _score_uncertainties(
    run: RunDirectory, manifest: Manifest, frames: RunFrames, skipped: dict[str, str], seed: int, on_event: OnEvent
) -> dict[str, UncertaintyMetrics]:
    metrics = {}
    for sensor in _sensors_with_beta(run, manifest, skipped):
        score = partial(score_uncertainty, frames, sensor, seed, on_event)
        scores = score_or_skip(f"uncertainty/{sensor}", skipped, score)
        if scores is not None:
            metrics[sensor] = scores
    return metrics


def _sensors_with_beta(run: RunDirectory, manifest: Manifest, skipped: dict[str, str]) -> list[str]:
    sensors = [s for s in manifest.sensors if s != GROUND_TRUTH_SENSOR and run.beta_path(s, 0).parent.is_dir()]
    if not sensors:
        skipped["uncertainty"] = "the run has no maps of the error scale (beta)"
        return []
    if GROUND_TRUTH_SENSOR not in manifest.sensors:
        skipped["uncertainty"] = f"the run has no ground-truth depth (a sensor named {GROUND_TRUTH_SENSOR})"
        return []
    return sensors


def _notes(
    surface: SurfaceMetrics | None, trajectory: TrajectoryMetrics | None, tracking: TrackingMetrics | None
) -> tuple[str, ...]:
    notes: list[str] = []
    if surface is not None:
        notes += surface.notes
    if trajectory is not None and tracking is None and trajectory.ate_m.max < MAX_GIVEN_POSE_ERROR_M:
        notes.append("the camera poses were given, not estimated: the trajectory errors have no meaning")
    return tuple(notes)
