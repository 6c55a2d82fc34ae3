"""How each kind of method makes its map: tracked first and fused in one go, frame by frame, or all by itself."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from ..core.device import choose_device
from ..core.events import track_progress
from ..core.frame import Frame
from ..core.tensor_files import save_tensors
from ..tracking.base import Tracker, require_found
from ..tracking.factory import choose_tracker
from .base import MapJob, MapResult, require_surface, rounded_seconds
from .map_output import MapOutput
from .online import map_online
from .registry import method_spec
from .spec import MethodSpec


def make_map(job: MapJob) -> MapResult:
    """Make the map of `job` by the method that its settings name. Raises DataError if there is no surface."""
    spec = method_spec(job.config.method)
    return RUNNERS[spec.kind](job, spec)


def run_full(job: MapJob, spec: MethodSpec) -> MapResult:
    """A method that tracks, maps and writes its files by itself."""
    result: MapResult = spec.load()(job)
    return result


def run_batch(job: MapJob, spec: MethodSpec) -> MapResult:
    """A method that fuses all frames at known poses; with `tracking.enabled` they are tracked beforehand."""
    started = time.time()
    tracker = choose_tracker(job.frames, job.config)
    poses = _track_without_map(job, tracker) if job.config.tracking.enabled else None
    tracked = time.time()
    field, poses = spec.load()(job.frames, job.indices, job.config, job.on_event, poses)
    require_surface(field)
    MapOutput(job.run).drop_earlier_map()
    seconds = {"tracking": tracked - started} if job.config.tracking.enabled else {}
    seconds["fusion"] = time.time() - tracked
    return MapResult(field, poses, tracker.record(), {"seconds": rounded_seconds(seconds)})


def run_online(job: MapJob, spec: MethodSpec) -> MapResult:
    """A method that tracks and maps frame by frame."""
    output = MapOutput(job.run)
    system = spec.load()(job.frames, job.config, choose_device(job.config.device))
    result = map_online(
        job.frames, job.indices, job.config, system, job.checkpoint, output.write_beta, job.on_event
    )  # fmt: skip
    require_surface(result.field)
    output.drop_earlier_map()
    output.write_curves(result.curves)
    save_tensors(job.run.method_state_path, system.artifacts())
    facts = {"seconds": rounded_seconds(result.seconds), "keyframes": system.keyframes()}
    return MapResult(result.field, result.poses, result.tracking, facts)


RUNNERS: dict[str, Callable[[MapJob, MethodSpec], MapResult]] = {
    "full": run_full,
    "online": run_online,
    "batch": run_batch,
}


def _track_without_map(job: MapJob, tracker: Tracker) -> dict[int, np.ndarray]:
    """T_world_camera by frame index from the images alone."""
    frames, count = job.frames, len(job.indices)

    def prepare(frame: Frame) -> tuple[Frame, Any]:
        return frame, tracker.prepare(frame, {s: frames.normals(frame.index, s) for s in frames.sensors})

    for frame, prepared in track_progress(frames.stream(job.indices, prepare), count, "tracking", job.on_event):
        tracker.track(frame, prepared, {})
    poses = tracker.finish()
    require_found(poses, count)
    return poses
