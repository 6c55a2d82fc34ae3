"""The method: fuse, learn where the sensors err, fuse again with that knowledge, refine by rendering."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...core.config.map_config import MapConfig
from ...core.device import choose_device
from ...core.errors import DataError
from ...core.events import Note, OnEvent, Progress, ignore
from ...core.frame import Frame
from ...mvs.bias_correction import CONSISTENCY_TEST_VIEWS
from ...mvs.photometric_depth import MAX_REGISTRATION_PX
from ...run.checkpoint import Checkpoint
from ...run.frames import RunFrames
from ...run.tracking_record import TrackingRecord
from ...sensors.noise_prior import NoisePrior
from ...tracking.base import Tracker, require_found
from ...tracking.factory import choose_tracker
from ...volume.neural_field import NeuralField
from ..base import OnBeta
from .mapper import Mapper
from .progress import RunProgress
from .refinement import refine_field


@dataclass(frozen=True)
class View:
    """A frame, by sensor the (H, W, F) features that its uncertainty is learned from, and what its tracker prepared."""

    frame: Frame
    features: dict[str, Tensor]
    prepared: Any = None


@dataclass(frozen=True)
class Reconstruction:
    """field, T_world_camera of each mapped frame, likelihood curves by name (nats), seconds by part; how sure the poses
    are, if they were tracked."""

    mapper: Mapper
    field: NeuralField
    poses: dict[int, np.ndarray]
    curves: dict[str, list[float]]
    seconds: dict[str, float]
    tracking: TrackingRecord | None


def reconstruct(
    frames: RunFrames,
    indices: list[int],
    config: MapConfig,
    checkpoint: Checkpoint,
    on_beta: OnBeta,
    on_event: OnEvent = ignore,
    prior: NoisePrior | None = None,
) -> Reconstruction:
    """Reconstruct `indices` of `frames`. Continues from `checkpoint` if it holds a state, with the same result.

    The noise models of sensors that are in `prior` start from it.

    The first sweep explores: track, map, record, frame by frame, learning the noise online. Then the trajectory is
    made consistent, and each later sweep fuses all frames again with poses and weights as known by then. Colour that
    finds the surface elsewhere is asked again around the new one, with a sweep after each time. At last the field is
    refined by rendering, and beta maps are written.
    """
    mapper = Mapper(frames.camera, frames.sensors, config, choose_device(config.device))
    if prior is not None:
        prior.teach(mapper.noise)
    tracker = choose_tracker(frames, config, mapper.noise, mapper.volume)
    progress = _restore(checkpoint, mapper, tracker, on_event)
    if progress is None:  # poses that moved need one more sweep
        progress = RunProgress(last=max(config.fusion.passes, int(config.tracking.enabled)))
    while progress.sweep <= progress.last:
        sweep = progress.sweep
        for view in _sweep_views(frames, indices, sweep, mapper, tracker, progress, on_event):
            if sweep == 0:
                _explore(view, frames, mapper, tracker, progress)
            else:
                _fuse(view, mapper, progress)
            progress.position += 1
            if checkpoint.due():
                _save(checkpoint, mapper, tracker, progress)
        if config.tracking.enabled:
            require_found(progress.poses, len(indices))
        _end_sweep(frames, mapper, tracker, progress, on_event)
        if sweep < progress.last:
            mapper.clear_volume()
        progress.sweep, progress.position = sweep + 1, 0
        if checkpoint.due() or sweep == progress.last:  # what follows writes much, and the disk may be full
            _save(checkpoint, mapper, tracker, progress)
    with progress.timed("refining"):
        result, losses = refine_field(mapper, config, on_event)
    with progress.timed("beta maps"):
        _write_betas(frames, sorted(progress.poses), mapper, on_beta, on_event)
    poses = {index: np.array(matrix) for index, matrix in progress.poses.items()}
    return Reconstruction(
        mapper, result, poses, {**progress.losses, "refinement": losses}, progress.seconds, tracker.record()
    )


def _explore(view: View, frames: RunFrames, mapper: Mapper, tracker: Tracker, progress: RunProgress) -> None:
    """Track, judge the sensors, map, record."""
    frame, tracking = mapper.health.look(view.frame), mapper.config.tracking
    with progress.timed("tracking"):
        T_world_camera = tracker.track(mapper.health.without_faulty(frame), view.prepared, view.features)
    if T_world_camera is None:
        return
    with progress.timed("pass_1"):
        _follow(frames, mapper, tracker)
        frame = mapper.judge(frame, mapper.pose(T_world_camera))
        if not tracking.enabled or tracker.is_keyframe() or progress.position % tracking.integrate_every == 0:
            mapper.explore(frame, view.features, mapper.pose(T_world_camera))
    progress.poses[frame.index] = np.asarray(T_world_camera).tolist()


def _follow(frames: RunFrames, mapper: Mapper, tracker: Tracker) -> None:
    """Frames whose camera was moved by what was seen later, by a loop above all, are fused again from there.

    Only a keyframe moves others.
    """
    if not mapper.config.tracking.enabled or not tracker.is_keyframe():
        return
    poses = {index: mapper.pose(pose) for index, pose in tracker.poses().items()}
    moved = mapper.log.moved(poses, mapper.config.fusion.voxel_size_m)
    for view in _views(frames, moved, mapper) if moved else ():
        mapper.refuse(view.frame, view.features, poses[view.frame.index])


def _settle(mapper: Mapper, tracker: Tracker, progress: RunProgress) -> None:
    """The final poses take the place of those that were recorded on the way; the rays of the learner move along."""
    poses = tracker.finish()
    before = {i: entry.T_world_camera for i, entry in mapper.log.entries.items()}
    mapper.rays.move({i: mapper.pose(poses[i]) @ torch.linalg.inv(before[i]) for i in before if i in poses})
    mapper.log.clear()
    progress.poses |= {index: pose.tolist() for index, pose in poses.items()}


def _fuse(view: View, mapper: Mapper, progress: RunProgress) -> None:
    """Map again what was recorded."""
    recorded = progress.poses.get(view.frame.index)
    if recorded is None:
        return
    with progress.timed(f"pass_{progress.sweep + 1}"):
        pose = mapper.pose(recorded)
        frame = mapper.bias.corrected(view.frame, view.features)
        moved = mapper.config.tracking.enabled or frame is not view.frame  # the camera or its readings, since exploring
        if moved and (progress.sweep == 1 or mapper.bias.newly_active):  # else by less than the truncation band
            for depth in frame.depths.values():
                mapper.volume.allocate(depth.to(mapper.device), pose)
        mapper.fuse(frame, view.features, pose)


def _views(frames: RunFrames, indices: list[int], mapper: Mapper, tracker: Tracker | None = None) -> Iterator[View]:
    """Frames with their features, both made in the background while the frame before is being mapped.

    Sensors that were found to be at fault in a frame read nothing there.
    """

    def prepare(frame: Frame) -> View:
        frame = mapper.health.believed(frame)
        normals = {sensor: frames.normals(frame.index, sensor) for sensor in frames.sensors}
        return View(frame, mapper.features(frame, normals), tracker.prepare(frame, normals) if tracker else None)

    return frames.stream(indices, prepare)


def _sweep_views(
    frames: RunFrames,
    indices: list[int],
    sweep: int,
    mapper: Mapper,
    tracker: Tracker,
    progress: RunProgress,
    on_event: OnEvent,
) -> Iterator[View]:
    """What is left of a sweep, reported."""
    explores = "tracking and mapping" if mapper.config.tracking.enabled else "mapping"
    stage = explores if sweep == 0 else f"fusing again, sweep {sweep + 1}"
    for view in _views(frames, indices[progress.position :], mapper, tracker if sweep == 0 else None):
        on_event(Progress(stage, progress.position, len(indices)))
        yield view
    on_event(Progress(stage, len(indices), len(indices)))


def _end_sweep(
    frames: RunFrames, mapper: Mapper, tracker: Tracker, progress: RunProgress, on_event: OnEvent
) -> None:  # fmt: skip
    """Complete the map by what colour says, and learn from the whole of it; ask colour while it finds something new."""
    if not mapper.volume.grid.rows:
        raise DataError("no frame could be mapped: no depth reading within range has a camera pose")
    with progress.timed("photometric"):
        mapper.add_colors()
    if progress.sweep == 0:
        _learn(mapper, progress)
        with progress.timed("tracking"):
            _settle(mapper, tracker, progress)
    with progress.timed("photometric"):
        heard = (progress.sweep == 0 or mapper.witness.needs_another_pass()) and _hear_colors(
            frames, mapper, progress, on_event
        )
    if heard or progress.sweep > 0:
        _learn(mapper, progress)
    if heard:
        with progress.timed("photometric"):
            mapper.estimate_reliability()


def _learn(mapper: Mapper, progress: RunProgress) -> None:
    """What the whole map teaches the noise models; at last about the readings as they come."""
    if mapper.config.uncertainty.enabled:
        with progress.timed("learning"):
            losses = mapper.learn(raw_target=progress.sweep == progress.last)
        for sensor, loss in losses.items():
            if math.isfinite(loss):
                progress.losses.setdefault(f"noise/{sensor}", []).append(loss)


def _hear_colors(frames: RunFrames, mapper: Mapper, progress: RunProgress, on_event: OnEvent) -> bool:
    """Ask colour, around the surface that the map shows, where it is; heard in the sweeps that follow.

    Returns whether it said anything.
    """
    config = mapper.config
    if not (config.photometric.enabled and config.uncertainty.enabled and config.fusion.passes):
        return False
    if frames.registration_sigma_px > MAX_REGISTRATION_PX:
        off = f"{frames.registration_sigma_px:g} px"
        on_event(Note(f"colour may lie {off} beside its depth, so it does not say where the surface is"))
        return False
    poses = {index: np.array(pose) for index, pose in progress.poses.items()}
    surface = mapper.surface()
    loss = mapper.witness.look(frames, poses, surface, on_event)
    if loss is None:
        return False
    progress.losses.setdefault("noise/photometric", []).append(loss)
    for number, view in enumerate(_views(frames, mapper.witness.indices, mapper)):
        mapper.witness.sample_view(view.frame, view.features, number, surface)
    tried = mapper.witness.indices[:: 1 + len(mapper.witness.indices) // CONSISTENCY_TEST_VIEWS]
    mapper.bias.hear(mapper.witness, ((view.frame, view.features) for view in _views(frames, tried, mapper)))
    if mapper.witness.needs_another_pass():  # after the next sweep, and one more that hears what it then says
        progress.last = max(progress.last, progress.sweep + 2)
    return True


def _write_betas(frames: RunFrames, indices: list[int], mapper: Mapper, on_beta: OnBeta, on_event: OnEvent) -> None:
    if not mapper.config.uncertainty.enabled:
        return
    stage = "writing beta maps"
    for done, view in enumerate(_views(frames, indices, mapper)):
        on_event(Progress(stage, done, len(indices)))
        for sensor, features in view.features.items():
            depth = view.frame.depths[sensor].to(mapper.device)
            beta = mapper.noise[sensor].beta_image(depth, features.to(mapper.device))
            on_beta(view.frame.index, sensor, beta.cpu())
    on_event(Progress(stage, len(indices), len(indices)))


def _save(checkpoint: Checkpoint, mapper: Mapper, tracker: Tracker, progress: RunProgress) -> None:
    checkpoint.save(
        {"mapper": mapper.state_dict(), "tracker": tracker.state_dict(), "progress": dict(vars(progress))}
    )  # fmt: skip


def _restore(checkpoint: Checkpoint, mapper: Mapper, tracker: Tracker, on_event: OnEvent) -> RunProgress | None:
    state: dict[str, Any] | None = checkpoint.load()
    if state is None:
        return None
    mapper.load_state_dict(state["mapper"])
    tracker.load_state_dict(state["tracker"])
    progress = RunProgress(**state["progress"])
    on_event(Note(f"continuing at sweep {progress.sweep + 1}, frame {progress.position}"))
    return progress
