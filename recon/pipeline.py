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
class View:
    """A frame and, by sensor, the (H, W, F) features that its uncertainty is learned from."""

    frame: Frame
    features: dict[str, Tensor]


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
        for view in _sweep_views(frames, indices, sweep, mapper, progress, on_event):
            with _timed(progress, f"sweep {sweep + 1}"):
                _map_view(view, mapper, tracker, progress, explore=sweep == 0)
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


def _map_view(view: View, mapper: Mapper, tracker: Tracker, progress: Progression, explore: bool) -> None:
    """Track, map, record."""
    frame = view.frame
    T_world_camera = tracker.track(frame) if explore else progress.poses.get(frame.index)
    if T_world_camera is None:
        return
    progress.poses[frame.index] = np.asarray(T_world_camera).tolist()
    pose = torch.tensor(T_world_camera, dtype=torch.float32, device=mapper.device)
    if explore:
        mapper.explore(frame, view.features, pose)
    else:
        mapper.fuse(frame, view.features, pose)


def _views(frames: RunFrames, indices: list[int], mapper: Mapper) -> Iterator[View]:
    """Frames with their features, both made in the background while the frame before is being mapped."""

    def prepare(frame: Frame) -> View:
        normals = {sensor: frames.normals(frame.index, sensor) for sensor in frames.sensors}
        return View(frame, mapper.features(frame, normals))

    return frames.stream(indices, prepare)


def _sweep_views(
    frames: RunFrames, indices: list[int], sweep: int, mapper: Mapper, progress: Progression, on_event: OnEvent
) -> Iterator[View]:
    """What is left of a sweep, reported."""
    stage = "mapping" if sweep == 0 else f"fusing again, sweep {sweep + 1}"
    for view in _views(frames, indices[progress.position :], mapper):
        on_event(Progress(stage, progress.position, len(indices)))
        yield view
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
    far_m, step_m = mapper.volume.ray_far_m, mapper.volume.ray_step_m
    losses = refine(result, mapper.rays, mapper.noise, config.field, far_m, step_m, generator, on_event)
    return result, losses


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
