"""How each method makes its map: fusion with learned uncertainty, plain fusion, or a field optimised frame by frame."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from ..core.config.map_config import MapConfig
from ..core.errors import DataError
from ..core.events import OnEvent, track_progress
from ..core.frame import Frame
from ..core.tensor_files import save_tensors
from ..run.frames import RunFrames
from ..sensors.noise_prior import save_noise_models
from ..tracking.base import Tracker, require_found
from ..tracking.factory import choose_tracker
from ..volume.neural_field import NeuralField
from .base import MapJob, MapResult
from .confidence.models import ConfidenceModels
from .map_output import MapOutput
from .nice.scene import choose_decoders
from .online import OnlineSystem, map_online
from .open3d_tsdf import fuse_open3d
from .senfunet.fuse import fuse_senfunet, require_pair
from .senfunet.models import SenfunetModel
from .uncle.pipeline import choose_device, reconstruct


def _vox_fusion(frames: RunFrames, config: MapConfig, device: torch.device) -> OnlineSystem:
    from .vox.system import VoxSystem

    return VoxSystem(frames, config, device)


def _nice(frames: RunFrames, config: MapConfig, device: torch.device) -> OnlineSystem:
    from .nice.system import NiceSystem

    return NiceSystem(frames, config, device)


# method -> its system; imported when it is wanted
ONLINE_METHODS: dict[str, Callable[[RunFrames, MapConfig, torch.device], OnlineSystem]] = {
    "uncle-paper": _nice,
    "nice-slam": _nice,
    "nice-slam-pre": _nice,
    "vox-fusion": _vox_fusion,
}

Poses = dict[int, np.ndarray]
Fuse = Callable[[RunFrames, list[int], MapConfig, OnEvent, Poses | None], tuple[NeuralField, Poses]]


def _fuse_senfunet(frames: RunFrames, indices: list[int], config: MapConfig, on_event: OnEvent, poses: Poses | None):
    model = _senfunet_model(config)
    return fuse_senfunet(frames, indices, config, model, choose_device(config.device), on_event, poses)


def _senfunet_model(config: MapConfig) -> SenfunetModel | None:
    pair = require_pair(config.sensors)
    return SenfunetModel.load(pair, config.senfunet.file or None) if pair else None


# method -> one fusion of all frames, their poses being known
BATCH_METHODS: dict[str, Fuse] = {"tsdf": fuse_open3d, "senfunet": _fuse_senfunet}


def trained_parts(config: MapConfig) -> list[str]:
    """Digests of the networks in files that decide what the method makes. Raises ConfigError if there are none."""
    if config.method == "senfunet":
        model = _senfunet_model(config)
        return [model.digest] if model else []
    if ONLINE_METHODS.get(config.method) is _nice:
        found = [choose_decoders(config.nice.decoders).digest]
        if config.nice.weighting == "confidence":
            found.append(ConfidenceModels.load(config.sensors, config.confidence.files).digest)
        return found
    return []


def make_map(job: MapJob) -> MapResult:
    """Make the map of `job` by the method that its settings name. Raises DataError if there is no surface."""
    if job.config.method in ONLINE_METHODS:
        return _run_online(job, ONLINE_METHODS[job.config.method])
    plain = BATCH_METHODS.get(job.config.method)
    return _run_batch(job, plain) if plain else _run_uncle(job)


def _run_uncle(job: MapJob) -> MapResult:
    output, config = MapOutput(job.run), job.config
    made = reconstruct(
        job.frames, job.indices, config, job.checkpoint, output.write_beta, job.on_event, job.prior
    )  # fmt: skip
    _require_surface(made.field)
    output.drop_earlier_map()
    output.write_curves(made.curves)
    facts = {"seconds": _rounded(made.seconds), "keyframes": len(made.mapper.selector.T_camera_world)}
    facts["bias_test_improved_ratio"] = {
        sensor: round(share, 4) for sensor, share in made.mapper.bias.confirmed.items()
    }
    facts["bias_corrected_sensors"] = sorted(made.mapper.bias.believed())
    facts["sensor_reliability"] = {sensor: round(worth, 4) for sensor, worth in made.mapper.weights.worth.items()}
    facts["error_quantiles_in_beta"] = {sensor: widths for sensor, widths in made.mapper.intervals.items() if widths}
    facts["sensor_weight_share"] = {sensor: round(share, 4) for sensor, share in made.mapper.weight_share().items()}
    facts |= output.write_faults(made.mapper.health, job.on_event)
    if config.uncertainty.enabled:
        save_noise_models(job.run.noise_model_path, made.mapper.noise)
    return MapResult(made.field, made.poses, made.tracking, facts)


def _run_batch(job: MapJob, fuse: Fuse) -> MapResult:
    began = time.time()
    tracker = choose_tracker(job.frames, job.config)
    poses = _track_alone(job, tracker) if job.config.tracking.enabled else None
    tracked = time.time()
    field, poses = fuse(job.frames, job.indices, job.config, job.on_event, poses)
    _require_surface(field)
    MapOutput(job.run).drop_earlier_map()
    seconds = {"tracking": tracked - began} if job.config.tracking.enabled else {}
    return MapResult(field, poses, tracker.record(), {"seconds": _rounded(seconds | {"fusion": time.time() - tracked})})


def _run_online(job: MapJob, make_system: Callable[[RunFrames, MapConfig, torch.device], OnlineSystem]) -> MapResult:
    output = MapOutput(job.run)
    system = make_system(job.frames, job.config, choose_device(job.config.device))
    made = map_online(
        job.frames, job.indices, job.config, system, job.checkpoint, output.write_beta, job.on_event
    )  # fmt: skip
    _require_surface(made.field)
    output.drop_earlier_map()
    output.write_curves(made.curves)
    save_tensors(job.run.method_state_path, system.artifacts())
    return MapResult(
        made.field, made.poses, made.tracking, {"seconds": _rounded(made.seconds), "keyframes": system.keyframes()}
    )


def _track_alone(job: MapJob, tracker: Tracker) -> dict[int, np.ndarray]:
    """Poses by frame index from the images alone, without a map."""
    frames, count = job.frames, len(job.indices)

    def prepare(frame: Frame) -> tuple[Frame, Any]:
        return frame, tracker.prepare(frame, {s: frames.normals(frame.index, s) for s in frames.sensors})

    for frame, prepared in track_progress(frames.stream(job.indices, prepare), count, "tracking", job.on_event):
        tracker.track(frame, prepared, {})
    poses = tracker.finish()
    require_found(poses, count)
    return poses


def _require_surface(field: NeuralField) -> None:
    if not bool(field.known.any()):
        raise DataError(
            "nothing was seen often enough to make a surface; map more frames or lower fusion.min_observations"
        )


def _rounded(seconds: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 2) for name, value in seconds.items()}
