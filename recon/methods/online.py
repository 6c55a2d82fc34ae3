"""The shared loop of systems that optimise a field frame by frame: track, map, record."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from torch import Tensor

from ..core.config.map_config import MapConfig
from ..core.events import Note, OnEvent, Progress, ignore
from ..core.frame import Frame
from ..core.tensor_files import taking_apart
from ..core.timing import Timed
from ..run.checkpoint import Checkpoint
from ..run.frames import RunFrames
from ..run.tracking_record import Status, TrackedFrame, TrackingRecord
from ..tracking.base import require_found
from ..volume.neural_field import NeuralField
from .base import OnBeta, Poses


@dataclass(frozen=True)
class Found:
    """Where a tracker says that the camera is: T_world_camera (4, 4), None where it is lost; covariance (6, 6) as in
    `TrackedFrame`, None where the tracker cannot tell."""

    T_world_camera: np.ndarray | None
    status: Status = "tracked"
    covariance: np.ndarray | None = None


class OnlineSystem(Protocol):
    """A field, its mapper and its tracker.

    map_every            frames from one that is mapped to the next; the first and the last are always mapped
    learns_uncertainty   whether `betas` says anything
    """

    map_every: int
    learns_uncertainty: bool

    def begin(self, indices: list[int], on_event: OnEvent) -> None:
        """Called once, before the first frame; not when a broken run continues."""

    def prepare(self, frame: Frame) -> Any:
        """What can be made of a frame in the background, before its turn."""

    def track(self, frame: Frame, prepared: Any, recent: list[np.ndarray]) -> Found:
        """Estimate the pose of a frame. recent: the last two estimated poses (4, 4) as they are now, newest last."""

    def map(self, frame: Frame, prepared: Any, T_world_camera: np.ndarray, last: bool) -> Poses:
        """Make a frame part of the map; returns the frames that were moved by it, the given one among them or not."""

    def betas(self, frame: Frame, prepared: Any) -> dict[str, Tensor]:
        """Scale of the errors of a frame's measurements by sensor, (H, W) metres, 0 where there is no measurement."""

    def field(self, poses: Poses, on_event: OnEvent) -> NeuralField:
        """The surface of the map, known only where the cameras saw it."""

    def curves(self) -> dict[str, list[float]]:
        """Mean negative log-likelihoods over time, by name, nats."""

    def keyframes(self) -> int:
        """How many frames the mapper keeps."""

    def artifacts(self) -> dict[str, Any]:
        """Everything that was learned, as plain tensors and containers: `map/method_state.pt` of a run."""

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from, bit for bit."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from what `state_dict` returned."""


@dataclass(frozen=True)
class OnlineResult:
    """What `map_online` made: see `Reconstruction`."""

    field: NeuralField
    poses: Poses
    curves: dict[str, list[float]]
    seconds: dict[str, float]
    tracking: TrackingRecord | None


@dataclass(kw_only=True)
class OnlineProgress(Timed):
    """The next position in the list of frames, the next one to be mapped, and what was recorded on the way."""

    position: int = 0
    next_mapped: int = 0
    poses: dict[int, list[list[float]]] = field(default_factory=dict)
    frames: list[dict[str, Any]] = field(default_factory=list)  # `TrackedFrame`


def map_online(
    frames: RunFrames, indices: list[int], config: MapConfig, system: OnlineSystem, checkpoint: Checkpoint,
    on_beta: OnBeta, on_event: OnEvent = ignore,
) -> OnlineResult:  # fmt: skip
    """Run `system` over `indices`. Continues from `checkpoint` if it holds a state, with the same result.

    Raises DataError if the camera is lost in every frame.
    """
    progress = _restore(checkpoint, system, on_event) or _begin(system, indices, on_event)
    if config.tracking.enabled:
        _track_and_map(frames, indices, system, checkpoint, progress, on_event)
        require_found(progress.poses, len(indices))
    else:
        _map_given(frames, indices, system, checkpoint, progress, on_event)
    poses = {index: np.array(matrix) for index, matrix in progress.poses.items()}
    with progress.timed("surface"):
        surface = system.field(poses, on_event)
    with progress.timed("beta maps"):
        _write_betas(frames, sorted(poses), system, on_beta, on_event)
    tracked = TrackingRecord(frames=tuple(TrackedFrame.model_validate(entry) for entry in progress.frames))
    tracking = tracked if config.tracking.enabled else None
    return OnlineResult(surface, poses, system.curves(), progress.seconds, tracking)


def _begin(system: OnlineSystem, indices: list[int], on_event: OnEvent) -> OnlineProgress:
    progress = OnlineProgress()
    with progress.timed("mapping"):
        system.begin(indices, on_event)
    return progress


def _track_and_map(
    frames: RunFrames, indices: list[int], system: OnlineSystem, checkpoint: Checkpoint, progress: OnlineProgress,
    on_event: OnEvent,
) -> None:  # fmt: skip
    stage, start, last = "tracking and mapping", progress.position, len(indices) - 1
    for frame, prepared in frames.stream(indices[start:], lambda frame: (frame, system.prepare(frame))):
        on_event(Progress(stage, progress.position, len(indices)))
        with progress.timed("tracking"):
            found = _estimate_pose(system, frame, prepared, progress)
        if found.T_world_camera is not None:
            progress.poses[frame.index] = found.T_world_camera.tolist()
            if progress.position >= progress.next_mapped or progress.position == last:
                _map(system, frame, prepared, found.T_world_camera, progress.position == last, progress)
                progress.next_mapped = progress.position + system.map_every
        progress.position += 1
        _save_if(checkpoint.due(), checkpoint, system, progress)
    on_event(Progress(stage, len(indices), len(indices)))
    _save_if(start < len(indices), checkpoint, system, progress)


def _map_given(
    frames: RunFrames, indices: list[int], system: OnlineSystem, checkpoint: Checkpoint, progress: OnlineProgress,
    on_event: OnEvent,
) -> None:  # fmt: skip
    """With given poses only the frames to be mapped are read."""
    stage, last = "mapping", len(indices) - 1
    progress.poses = {
        index: frames.known_pose(index).tolist() for index in indices
    }  # a recording's poses stay what they are
    due = sorted({*range(progress.next_mapped, len(indices), system.map_every), last} - set(range(progress.position)))
    chosen = [indices[position] for position in due]
    views = frames.stream(chosen, lambda frame: (frame, system.prepare(frame)))
    for position, (frame, prepared) in zip(due, views, strict=True):
        on_event(Progress(stage, position, len(indices)))
        _map(system, frame, prepared, frames.known_pose(frame.index), position == last, progress)
        progress.position, progress.next_mapped = position + 1, position + system.map_every
        _save_if(checkpoint.due(), checkpoint, system, progress)
    on_event(Progress(stage, len(indices), len(indices)))
    _save_if(bool(due), checkpoint, system, progress)


def _estimate_pose(system: OnlineSystem, frame: Frame, prepared: Any, progress: OnlineProgress) -> Found:
    """The pose of the next frame, recorded. The first one is where the recording says, else at the origin."""
    if progress.poses:
        recent = [np.array(progress.poses[index]) for index in sorted(progress.poses)[-2:]]
        found = system.track(frame, prepared, recent)
    else:
        start = np.eye(4) if frame.T_world_camera is None else frame.T_world_camera
        seen = any(bool(depth.any()) for depth in frame.depths.values())
        found = Found(np.asarray(start), "tracked", np.zeros((6, 6))) if seen else Found(None, "lost")
    covariance = None if found.covariance is None else found.covariance.tolist()
    entry = TrackedFrame(
        index=frame.index, timestamp=frame.timestamp, status=found.status, covariance=covariance
    )  # fmt: skip
    progress.frames.append(entry.model_dump())
    return found


def _map(
    system: OnlineSystem, frame: Frame, prepared: Any, T_world_camera: np.ndarray, last: bool, progress: OnlineProgress
) -> None:
    with progress.timed("mapping"):
        moved = system.map(frame, prepared, T_world_camera, last)
    progress.poses |= {index: np.asarray(pose).tolist() for index, pose in moved.items() if index in progress.poses}


def _write_betas(
    frames: RunFrames, indices: list[int], system: OnlineSystem, on_beta: OnBeta, on_event: OnEvent
) -> None:
    if not system.learns_uncertainty:
        return
    stage = "writing beta maps"
    for done, (frame, prepared) in enumerate(frames.stream(indices, lambda frame: (frame, system.prepare(frame)))):
        on_event(Progress(stage, done, len(indices)))
        for sensor, beta in system.betas(frame, prepared).items():
            on_beta(frame.index, sensor, beta.cpu())
    on_event(Progress(stage, len(indices), len(indices)))


def _save_if(wanted: bool, checkpoint: Checkpoint, system: OnlineSystem, progress: OnlineProgress) -> None:
    if wanted:
        checkpoint.save({"system": system.state_dict(), "progress": dict(vars(progress))})


def _restore(checkpoint: Checkpoint, system: OnlineSystem, on_event: OnEvent) -> OnlineProgress | None:
    state = checkpoint.load()
    if state is None:
        return None
    with taking_apart(checkpoint.path):
        system.load_state_dict(state["system"])
        progress = OnlineProgress(**state["progress"])
    on_event(Note(f"continuing at frame {progress.position}"))
    return progress
