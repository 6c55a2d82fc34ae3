"""The `map` stage of a run: choose frames, reconstruct, and write what came out."""

from __future__ import annotations

import resource
import sys
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..core.config.map_config import MapConfig, to_toml
from ..core.device import choose_device
from ..core.errors import ConfigError, DataError, RunError
from ..core.events import Note, OnEvent, Warn, ignore
from ..core.files import write_text
from ..core.tensor_files import load_tensors, save_tensors, taking_apart
from ..core.trajectory import Trajectory
from ..methods.base import MapJob
from ..methods.registry import method_spec
from ..methods.runners import make_map
from ..run.checkpoint import Checkpoint
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from ..run.lock import writing
from ..run.manifest import Manifest, config_hash
from ..run.tracking_record import TrackingRecord
from ..sensors.noise_prior import NoisePrior
from ..sensors.voxel_size import VoxelSize, choose_voxel_size
from ..tracking.base import GivenPoses
from ..volume.block_index import RANGE
from ..volume.neural_field import NeuralField
from ..volume.sparse_grid import BLOCK
from .base import StageSummary

STAGE = "map"


@dataclass(frozen=True, kw_only=True)
class MapSummary(StageSummary):
    """Number of frames in the map, and the largest resident memory of the process; 0 if the map was kept."""

    frames: int
    peak_memory_mb: float = 0.0


def map_run(
    run: RunDirectory, config: MapConfig, *, prior: NoisePrior | None = None, resume: bool = False,
    overwrite: bool = False, on_event: OnEvent = ignore,
) -> MapSummary:  # fmt: skip
    """Make the map of `run` and its trajectory, beta maps, noise models, curves and configuration.

    A finished map of the same settings and the same `prior`, which the noise models start from, is kept unless
    `overwrite`; `resume` continues an interrupted one. Raises ConfigError for unknown sensors or a prior that does not
    fit, DataError if nothing can be mapped, RunError for files, or if another process writes into the run.
    """
    with writing(run, STAGE, on_event):
        return _map(run, config, prior, resume, overwrite, on_event)


def _map(
    run: RunDirectory, config: MapConfig, prior: NoisePrior | None, resume: bool, overwrite: bool, on_event: OnEvent
) -> MapSummary:
    manifest = run.load_manifest()
    config = config.model_copy(update={"sensors": choose_sensors(manifest, config.sensors)})
    spec = method_spec(config.method)
    spec.check_sensors(config.sensors)
    preprocessed = run.require_stage("preprocess")
    frames = RunFrames(run, config.sensors)
    config, voxel = _with_voxel_size(config, frames)
    made_with = [
        preprocessed.output or preprocessed.config_hash,
        *([prior.digest] if prior else []),
        *spec.trained_digests(config),
    ]
    digest = config_hash(config.model_dump(mode="json"), *made_with)
    checkpoint = Checkpoint(run.checkpoint_path, digest)
    continues = resume and not overwrite and checkpoint.load() is not None  # a broken --overwrite goes on, too
    if run.is_current(STAGE, digest) and not overwrite and not continues:
        return MapSummary(frames=len(Trajectory.load(run.trajectory_path)), unchanged=True)
    facts: dict[str, Any] = {} if prior is None else {"prior": _checked(prior, run, config, on_event)}
    if voxel is not None:
        on_event(Note(f"voxel size {100 * voxel.size_m:g} cm ({voxel.reason}); --voxel sets another"))
    indices, held_out = split_frames(frames, config, on_event)
    _prepare(checkpoint, resume and not overwrite, on_event)
    torch.manual_seed(config.seed)
    started = time.time()
    result = make_map(MapJob(run, frames, indices, config, checkpoint, prior, on_event))
    facts |= result.facts
    run.begin_stage(STAGE)
    save_tensors(run.field_path, result.field.to_state())
    _trajectory(frames, result.poses).moved(manifest.world_offset_m).save(run.trajectory_path)
    if result.tracking is not None:
        result.tracking.save(run.tracking_path)
        facts["tracking"] = result.tracking.counts()
        _report_lost(result.tracking, on_event)
    write_text(run.config_path, to_toml(config))
    if voxel is not None:
        facts["voxel_size"] = {"metres": voxel.size_m, "chosen_by": voxel.reason}
    facts |= {"method": config.method, "sensors": list(config.sensors), "seed": config.seed, "held_out": held_out}
    facts |= {
        "device": str(choose_device(config.device)),
        "frames": len(result.poses),
        "peak_memory_mb": peak_memory_mb(),
        **gpu_memory(),
    }
    run.finish_stage(STAGE, digest, started, facts, inputs=("preprocess",))
    checkpoint.remove()
    return MapSummary(frames=len(result.poses), seconds=time.time() - started, peak_memory_mb=facts["peak_memory_mb"])


def load_field(run: RunDirectory, device: str = "cpu") -> NeuralField:
    """The finished map of a run. Raises RunError if there is none."""
    run.require_stage(STAGE)
    state = load_tensors(run.field_path)
    with taking_apart(run.field_path):
        return NeuralField.from_state(state, device)


def choose_sensors(manifest: Manifest, wanted: tuple[str, ...]) -> tuple[str, ...]:
    """`wanted`, or every sensor but the ground truth. Raises ConfigError naming what there is."""
    unknown = [sensor for sensor in wanted if sensor not in manifest.sensors]
    if unknown:
        raise ConfigError(f"no sensor called {unknown[0]!r} in this run; it has: {', '.join(manifest.sensors)}")
    return tuple(dict.fromkeys(wanted)) or tuple(s for s in manifest.sensors if s != "gt") or manifest.sensors


def _with_voxel_size(config: MapConfig, frames: RunFrames) -> tuple[MapConfig, VoxelSize | None]:
    """The settings with a voxel size, and what it was chosen by if they had none."""
    fusion = config.fusion
    if fusion.voxel_size_m > 0:
        return config, None
    voxel = choose_voxel_size(frames, len(frames), config.sensors, fusion.max_depth_m)
    changed = fusion.model_copy(update={"voxel_size_m": voxel.size_m})
    return config.model_copy(update={"fusion": changed}), voxel


def split_frames(frames: RunFrames, config: MapConfig, on_event: OnEvent = ignore) -> tuple[list[int], list[int]]:
    """Indices to map, and those held out: every `config.hold_out`-th.

    Where poses are not tracked, frames need one. Raises DataError if none has.
    """
    if config.tracking.enabled:
        posed = list(range(len(frames)))
    else:
        posed = [index for index in range(len(frames)) if frames.pose(index) is not None]
        GivenPoses.check(bool(posed))
    if len(posed) < len(frames):
        on_event(Warn(f"{len(frames) - len(posed)} of {len(frames)} frames have no camera pose and are left out"))
    if not config.tracking.enabled:
        posed = _within_range(posed, frames, config, on_event)
    every = config.hold_out
    held_out = [index for index in posed if every and index % every == every - 1]
    return sorted(set(posed) - set(held_out)), held_out


def _within_range(posed: list[int], frames: RunFrames, config: MapConfig, on_event: OnEvent) -> list[int]:
    """The frames whose surroundings the voxel grid can hold; a warning names the others. Raises DataError for none."""
    limit_m = RANGE * BLOCK * config.fusion.voxel_size_m - config.fusion.max_depth_m
    beyond = [index for index in posed if np.abs(frames.known_pose(index)[:3, 3]).max() > limit_m]
    if beyond:
        text = f"{len(beyond)} of {len(frames)} frames lie more than {limit_m / 1000:.0f} km from the origin"
        if len(beyond) == len(posed):
            raise DataError(f"{text}: no frame can be mapped; give the poses in metres, from an origin nearby")
        on_event(Warn(f"{text} and are left out of the map; the first is frame {beyond[0]}"))
    return [index for index in posed if index not in beyond]


def gpu_memory() -> dict[str, float]:
    """The most that PyTorch held on the CUDA device so far, as a fact, MB; nothing where it held none."""
    peak = torch.cuda.max_memory_allocated() if torch.cuda.is_initialized() else 0
    return {"gpu_memory_mb": round(peak / 1e6, 1)} if peak else {}


def peak_memory_mb() -> float:
    """Largest resident memory of this process so far, MB."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak / (1e6 if sys.platform == "darwin" else 1e3), 1)


def _checked(prior: NoisePrior, run: RunDirectory, config: MapConfig, on_event: OnEvent) -> dict[str, Any]:
    """Facts of a prior that fits. Raises ConfigError."""
    if not config.uncertainty.enabled:
        raise ConfigError("--prior is about the learned uncertainty, which this map does not have; leave it out")
    if prior.path.resolve() == run.noise_model_path.resolve():
        raise ConfigError(f"--prior {prior.path}: the map that is made would replace it; copy the file elsewhere first")
    known = prior.covers(config.sensors)
    prior.require_fit(known, config.uncertainty)
    unknown = [sensor for sensor in config.sensors if sensor not in known]
    if unknown:
        on_event(Warn(f"--prior {prior.path} does not know {', '.join(unknown)}: learned from nothing"))
    return {"path": str(prior.path.resolve()), "digest": prior.digest, "sensors": known}


def _prepare(checkpoint: Checkpoint, resume: bool, on_event: OnEvent) -> None:
    if not checkpoint.path.exists():
        return
    if not resume:
        on_event(Note("an interrupted map of this run is dropped; use --resume to continue such a one"))
        checkpoint.remove()
    elif checkpoint.load() is None:
        raise RunError("the interrupted map has other settings; give the same ones, or start over without --resume")


def _report_lost(tracking: TrackingRecord, on_event: OnEvent) -> None:
    """One line on how many frames were lost and where."""
    ranges = tracking.lost_ranges()
    if ranges:
        lost = tracking.counts()["lost"]
        where = ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in ranges[:5])
        more = f" and {len(ranges) - 5} more stretches" if len(ranges) > 5 else ""
        text = f"the camera was lost in {lost} of {len(tracking.frames)} frames, left out of the map: {where}{more}"
        on_event(Warn(text))


def _trajectory(frames: RunFrames, poses: dict[int, np.ndarray]) -> Trajectory:
    order = sorted(poses)
    stamps = np.array([frames.records[index].timestamp for index in order])
    return Trajectory(stamps, np.stack([np.asarray(poses[index]) for index in order]))
