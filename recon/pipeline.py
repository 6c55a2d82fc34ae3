"""The method: fuse, learn where the sensors err, fuse again with that knowledge, refine by rendering."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .checkpoint import Checkpoint
from .config import MapConfig
from .errors import DataError
from .events import Note, OnEvent, Progress, ignore
from .field import NeuralField
from .frame import Frame
from .mapper import Mapper
from .recording import RunFrames
from .refine import refine
from .tracking import GivenPoses, Tracker

# (frame index, sensor, beta (H, W) metres): called once for every mapped frame with the final noise models
OnBeta = Callable[[int, str, Tensor], None]


@dataclass
class Progression:
    """How far the reconstruction is: the sweep, the next position in it, and what was recorded on the way."""

    sweep: int = 0
    position: int = 0
    poses: dict[int, list[list[float]]] = field(default_factory=dict)
    losses: dict[str, list[float]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Reconstruction:
    """field, T_world_camera of each mapped frame, likelihood curves by name (nats), seconds by part."""

    mapper: Mapper
    field: NeuralField
    poses: dict[int, np.ndarray]
    curves: dict[str, list[float]]
    seconds: dict[str, float]


def reconstruct(
    frames: RunFrames,
    indices: list[int],
    config: MapConfig,
    checkpoint: Checkpoint,
    on_beta: OnBeta,
    on_event: OnEvent = ignore,
    tracker: Tracker | None = None,
) -> Reconstruction:
    """Reconstruct `indices` of `frames`. Continues from `checkpoint` if it holds a state, with the same result.

    The first sweep explores: track, map, record, frame by frame, learning the noise online. Each later sweep fuses all
    frames again with the weights learned so far. At last the field is refined by rendering, and beta maps are written.
    """
    tracker = tracker or GivenPoses()
    mapper = Mapper(frames.camera, frames.sensors, config, choose_device(config.device))
    progress = _restore(checkpoint, mapper, on_event)
    for sweep in range(progress.sweep, 1 + config.fusion.sweeps):
        for frame in _sweep_frames(frames, indices, sweep, progress, on_event):
            with _timed(progress, f"sweep {sweep + 1}"):
                _map_frame(frame, frames, mapper, tracker, progress, explore=sweep == 0)
            progress.position += 1
            if checkpoint.due():
                _save(checkpoint, mapper, progress)
        with _timed(progress, "learning"):
            _end_sweep(mapper, progress, last=sweep == config.fusion.sweeps)
        progress.sweep, progress.position = sweep + 1, 0
        _save(checkpoint, mapper, progress)
    with _timed(progress, "refining"):
        result, losses = _refined_field(mapper, config, on_event)
    with _timed(progress, "beta maps"):
        _write_betas(frames, sorted(progress.poses), mapper, on_beta, on_event)
    poses = {index: np.array(matrix) for index, matrix in progress.poses.items()}
    return Reconstruction(mapper, result, poses, {**progress.losses, "refinement": losses}, progress.seconds)


def choose_device(name: str) -> torch.device:
    """`auto` takes CUDA where there is one. Raises DataError if `cuda` is asked for and missing."""
    if name == "cuda" and not torch.cuda.is_available():
        raise DataError("--device cuda: PyTorch finds no CUDA device here; use --device auto or cpu")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def _map_frame(
    frame: Frame, frames: RunFrames, mapper: Mapper, tracker: Tracker, progress: Progression, explore: bool
) -> None:
    """Track, map, record."""
    T_world_camera = tracker.track(frame) if explore else progress.poses.get(frame.index)
    if T_world_camera is None:
        return
    progress.poses[frame.index] = np.asarray(T_world_camera).tolist()
    pose = torch.tensor(T_world_camera, dtype=torch.float32, device=mapper.device)
    normals = {sensor: frames.normals(frame.index, sensor) for sensor in frames.sensors}
    if explore:
        mapper.explore(frame, normals, pose)
    else:
        mapper.fuse(frame, mapper.features(frame, normals), pose)


def _sweep_frames(
    frames: RunFrames, indices: list[int], sweep: int, progress: Progression, on_event: OnEvent
) -> Iterator[Frame]:
    """The frames that are left of a sweep, reported."""
    stage = "mapping" if sweep == 0 else f"fusing again, sweep {sweep + 1}"
    for frame in frames.stream(indices[progress.position :]):
        on_event(Progress(stage, progress.position, len(indices)))
        yield frame
    on_event(Progress(stage, len(indices), len(indices)))


def _end_sweep(mapper: Mapper, progress: Progression, last: bool) -> None:
    """Learn from the whole map; unless it is the final one, empty it for the next sweep."""
    if not mapper.volume.grid.rows:
        raise DataError("no frame could be mapped: no depth reading within range has a camera pose")
    if mapper.config.uncertainty.enabled:
        for sensor, loss in mapper.learn().items():
            if math.isfinite(loss):
                progress.losses.setdefault(f"noise {sensor}", []).append(loss)
    if not last:
        mapper.volume.reset()


def _refined_field(mapper: Mapper, config: MapConfig, on_event: OnEvent) -> tuple[NeuralField, list[float]]:
    generator = torch.Generator().manual_seed(config.seed)
    result = NeuralField.from_fusion(mapper.volume, config.fusion.min_readings, config.field, generator)
    far, step = config.fusion.max_depth_m * 1.2, 0.75 * mapper.volume.truncation_m
    losses = refine(result, mapper.rays, mapper.noise, config.field, far, step, generator, on_event)
    return result, losses


def _write_betas(frames: RunFrames, indices: list[int], mapper: Mapper, on_beta: OnBeta, on_event: OnEvent) -> None:
    if not mapper.config.uncertainty.enabled:
        return
    stage = "writing beta maps"
    for done, frame in enumerate(frames.stream(indices)):
        on_event(Progress(stage, done, len(indices)))
        normals = {sensor: frames.normals(frame.index, sensor) for sensor in frames.sensors}
        for sensor, features in mapper.features(frame, normals).items():
            depth = frame.depths[sensor].to(mapper.device)
            on_beta(frame.index, sensor, mapper.noise[sensor].beta_image(depth, features.to(mapper.device)).cpu())
    on_event(Progress(stage, len(indices), len(indices)))


def _save(checkpoint: Checkpoint, mapper: Mapper, progress: Progression) -> None:
    checkpoint.save({"mapper": mapper.state_dict(), "progress": dict(vars(progress))})


def _restore(checkpoint: Checkpoint, mapper: Mapper, on_event: OnEvent) -> Progression:
    state: dict[str, Any] | None = checkpoint.load()
    if state is None:
        return Progression()
    mapper.load_state_dict(state["mapper"])
    progress = Progression(**state["progress"])
    on_event(Note(f"continuing at sweep {progress.sweep + 1}, frame {progress.position}"))
    return progress


class _timed:
    """Adds the seconds of a block to `progress.seconds[name]`."""

    def __init__(self, progress: Progression, name: str) -> None:
        self.progress, self.name = progress, name

    def __enter__(self) -> None:
        self.started = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        spent = time.perf_counter() - self.started
        self.progress.seconds[self.name] = self.progress.seconds.get(self.name, 0.0) + spent
