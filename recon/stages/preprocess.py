"""The `preprocess` stage: read and check a recording and convert it into the frames of a run."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from ..core.correction import CorrectedRecording, Correction
from ..core.errors import DataError, RunError
from ..core.events import Note, OnEvent, Warn, ignore, track_progress
from ..core.far_frames import describe_far_frames, far_frames
from ..core.files import explain_write_errors, write_text
from ..core.frame import Recording
from ..core.trajectory import Trajectory
from ..core.world_offset import NO_OFFSET, Offset, describe_offset, world_offset
from ..evaluation.inspection.correspondences import FrameInterval
from ..evaluation.inspection.findings import Verdict, worst
from ..evaluation.inspection.inspector import QUICK, THOROUGH, inspect_recording
from ..run.directory import RunDirectory
from ..run.lock import writing
from ..run.manifest import FrameRecord, Manifest, config_hash
from .base import StageSummary
from .frame_conversion import FrameConverter, FrameResult
from .inspect import MAX_DEPTH_M, require_fitting

STAGE = "preprocess"
FRAMES_AHEAD = 2  # frames queued per thread: keeps all threads busy with little memory

T = TypeVar("T")
R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class PreprocessSummary(StageSummary):
    """`skipped` maps "source index" (a frame) or "source index/sensor" (one image) to the reason."""

    frames: int
    sensors: tuple[str, ...]
    skipped: dict[str, str]


def preprocess_run(  # noqa: PLR0913 (one argument for each option of the command)
    recording: Recording,
    run: RunDirectory,
    *,
    dataset: Path,
    frames: slice | None = None,
    sensors: Sequence[str] | None = None,
    lossless: bool = False,
    fix: bool = False,
    force: bool = False,
    overwrite: bool = False,
    on_event: OnEvent = ignore,
) -> PreprocessSummary:
    """Convert `recording`, read from the folder `dataset`, into the frames of `run`.

    The recording is inspected first (`uncle inspect`): what is wrong stops it, unless `fix` mends it or `force` goes
    on. Earlier frames are replaced only when the new ones are complete. A frame without readable colour or without any
    readable depth is skipped, an unreadable depth image is left out; both are reported and listed in the manifest.
    Stages made from earlier frames are marked as not done.

    Raises DataError if something is wrong, if a sensor is unknown or has no depth in any frame, or if no frame is
    usable; RunError if the run cannot be written, or another process writes into it.
    """
    chosen = _chosen_sensors(recording, sensors)
    indices = range(len(recording))[frames or slice(None)]
    if not indices:
        raise DataError(f"--frames selects none of the {len(recording)} frames of {dataset}")
    if run.root.resolve() == dataset.resolve():
        raise RunError(f"{run.root} is the data set itself; choose another place with --run")
    camera = recording.camera.to_dict()  # a file beside the data set may state it
    settings = config_hash(dataset_hash(dataset, run.root), recording.format, [*indices], chosen, lossless, fix, camera)
    with writing(run, STAGE, on_event, is_new=True):
        earlier = _earlier_manifest(run)
        if not overwrite and earlier and STAGE in earlier.stages and earlier.stages[STAGE].config_hash == settings:
            return _unchanged(run, earlier, on_event)

        started = time.time()
        for note in recording.notes:
            on_event(Note(note))
        correction = _inspect(recording, indices, chosen, fix=fix, force=force, on_event=on_event)
        if correction is not None:
            recording = CorrectedRecording(recording, correction)
        offset_m = _world_offset(recording, indices)
        if offset_m != NO_OFFSET:
            on_event(Note(describe_offset(offset_m)))
            recording = CorrectedRecording(recording, Correction(offset_m=offset_m))
        converter = FrameConverter(recording, chosen, ".png" if lossless else ".jpg")
        with _staging(run) as staging:
            results = _convert_all(converter, staging, indices, on_event)
            _report(results, recording, on_event)
            records = _renumbered(results, staging)
            _require_usable(records, results, chosen, dataset)
            rows = [record.model_dump(mode="json") for record in records]
            write_text(staging.frames_path, json.dumps(rows, indent=1))
            manifest = _manifest(recording, dataset, chosen, results, offset_m)
            if earlier is not None:
                manifest.stages, manifest.outdated = earlier.stages, earlier.outdated
            _publish(run, staging, manifest, records)
        if stale := [stage for stage in run.load_manifest().outdated if stage != STAGE]:
            on_event(Warn(f"these stages were made from the earlier frames; run them again: {', '.join(stale)}"))
        seconds = time.time() - started
        facts = {
            "frames": len(records),
            "frames_per_s": round(len(indices) / seconds, 1),
            "sensors": list(chosen),
            "frame_range": [indices.start, indices.stop, indices.step],
            "lossless": lossless,
            "correction": correction.describe() if correction is not None else {},
        }
        run.finish_stage(STAGE, settings, started, facts, output=frames_digest(manifest, records, results))
        return PreprocessSummary(frames=len(records), sensors=chosen, skipped=manifest.skipped, seconds=seconds)


def _inspect(
    recording: Recording, indices: range, sensors: Sequence[str], *, fix: bool, force: bool, on_event: OnEvent
) -> Correction | None:
    """Inspect the frames from the first to the last of `indices`, and decide what follows. Raises DataError.

    A quick inspection of some frames is enough to go on, but not to stop: what it finds wrong is looked for once more,
    thoroughly and in the whole recording. (Steady motion in a short part resembles a lag of the poses, for example.)
    """
    inspect = partial(
        inspect_recording,
        has_timestamps=recording.has_timestamps,
        max_depth_m=MAX_DEPTH_M,
        sensors=sensors,
        on_event=on_event,
    )
    part = FrameInterval(recording, min(indices), max(indices) + 1)
    inspection = inspect(part, effort=THOROUGH if fix else QUICK)
    is_final = force or (fix and len(part) == len(recording))
    if not is_final and (found := worst(inspection.fit)) is not None and found.verdict is Verdict.WRONG:
        on_event(Note(f"{found.check} may be wrong; inspecting the whole recording"))
        inspection = inspect(recording, effort=THOROUGH)
        if not any(finding.verdict is Verdict.WRONG for finding in inspection.fit):
            on_event(Warn(f"{found.check}: {found.text}; the whole recording does not show it, so it is left as it is"))
    return require_fitting(inspection, fix=fix, force=force, on_event=on_event)


def dataset_hash(dataset: Path, excluded: Path) -> str:
    """Hash of names, sizes and times of the files below `dataset`, without hidden ones and those below `excluded`.

    Links are followed, to files and to folders.
    """
    digest = hashlib.sha256(str(dataset.resolve()).encode())
    visited = {dataset.resolve()}  # a link can lead back to where it is
    for folder_name, subfolders, files in os.walk(dataset, followlinks=True):
        folder = Path(folder_name)
        targets = {name: (folder / name).resolve() for name in sorted(subfolders) if name[0] != "."}
        targets = {name: target for name, target in targets.items() if target != excluded.resolve()}
        subfolders[:] = [name for name, target in targets.items() if target not in visited]
        visited |= set(targets.values())
        digest.update("\0".join(f"{folder / name}\0{target}" for name, target in targets.items()).encode())
        for name in sorted(name for name in files if name[0] != "."):
            path = folder / name
            try:
                status, target = path.stat(), path.resolve()
            except OSError:
                continue
            digest.update(f"{path}\0{target}\0{status.st_size}\0{status.st_mtime_ns}\0".encode())
    return digest.hexdigest()


_READ_BY_STAGES = {"camera", "has_timestamps", "registration_sigma_px", "world_offset_m"}


def frames_digest(manifest: Manifest, records: Sequence[FrameRecord], results: Sequence[FrameResult]) -> str:
    """Digest of all that later stages read of the frames: images, poses, time stamps, camera."""
    images = [result.digest for result in results if result.record]
    values = manifest.model_dump(mode="json", include=_READ_BY_STAGES)
    return config_hash(images, [record.model_dump(mode="json") for record in records], values)


def _world_offset(recording: Recording, indices: Iterable[int]) -> Offset:
    poses = [pose for index in indices if (pose := recording.pose(index)) is not None]
    return world_offset(np.array(poses).reshape(-1, 4, 4)[:, :3, 3])


def _chosen_sensors(recording: Recording, sensors: Sequence[str] | None) -> tuple[str, ...]:
    chosen = tuple(dict.fromkeys(sensors)) if sensors else recording.sensors
    unknown = [name for name in chosen if name not in recording.sensors]
    if unknown:
        raise DataError(f"{recording.name} has no sensor {unknown[0]!r}; it has: {', '.join(recording.sensors)}")
    return chosen


def _earlier_manifest(run: RunDirectory) -> Manifest | None:
    """The manifest of `run`; None if there is none, or none that can be read. Raises RunError if it is not a run."""
    if not run.manifest_path.exists():
        if run.frames_path.parent.exists():
            raise RunError(f"{run.frames_path.parent} is not part of a run; choose another place with --run")
        return None
    try:
        return run.load_manifest()
    except RunError:  # damaged, or of another version: this is the command that redoes it
        return None


def _unchanged(run: RunDirectory, manifest: Manifest, on_event: OnEvent) -> PreprocessSummary:
    record = manifest.stages[STAGE]
    on_event(Note(f"{run.root} is up to date with {manifest.dataset}; --overwrite redoes it"))
    return PreprocessSummary(
        frames=record.facts["frames"], sensors=manifest.sensors, skipped=manifest.skipped, unchanged=True
    )


@contextmanager
def _staging(run: RunDirectory) -> Iterator[RunDirectory]:
    """A temporary run directory inside `run` for the new frames; it is always removed afterwards."""
    staging = RunDirectory(run.root / "frames.part")
    with explain_write_errors(run.root):
        shutil.rmtree(staging.root, ignore_errors=True)  # of an interrupted attempt
        staging.root.mkdir(parents=True)
    try:
        yield staging
    finally:
        shutil.rmtree(staging.root, ignore_errors=True)


def _convert_all(
    converter: FrameConverter, staging: RunDirectory, indices: Sequence[int], on_event: OnEvent
) -> list[FrameResult]:
    """Convert the frames `indices` in parallel; results in order."""
    threads = os.cpu_count() or 1
    threads_of_opencv = cv2.getNumThreads()
    cv2.setNumThreads(1)  # the frames already keep every core busy
    try:
        with ThreadPoolExecutor(threads) as pool:
            results = _ordered(
                pool, lambda pair: converter(staging, *pair), [*enumerate(indices)], FRAMES_AHEAD * threads
            )
            return list(track_progress(results, len(indices), STAGE, on_event))
    finally:
        cv2.setNumThreads(threads_of_opencv)


def _ordered(pool: ThreadPoolExecutor, work: Callable[[T], R], items: Sequence[T], ahead: int) -> Iterator[R]:
    """Results in the order of `items`, with at most `ahead` in progress; nothing new is started after a failure."""
    pending: list[Future[R]] = [pool.submit(work, item) for item in items[:ahead]]
    try:
        for position in range(len(items)):
            result = pending.pop(0).result()
            if position + ahead < len(items):
                pending.append(pool.submit(work, items[position + ahead]))
            yield result
    finally:
        for future in pending:
            future.cancel()


def _report(results: Sequence[FrameResult], recording: Recording, on_event: OnEvent) -> None:
    """One warning per kind of problem: how often it occurred, and the first case."""
    frames = [reason for r in results if r.record is None for reason in r.skipped.values()]
    if frames:
        on_event(Warn(f"{len(frames)} of {len(results)} frames skipped; the first: {frames[0]}"))
    for sensor in recording.sensors:
        reasons = [r.skipped[key] for r in results if r.record and (key := f"{r.source_index}/{sensor}") in r.skipped]
        if reasons:
            on_event(Warn(f"{len(reasons)} of {len(results)} {sensor} images left out; the first: {reasons[0]}"))
    posed = [r.record for r in results if r.record and r.record.T_world_camera is not None]
    if posed:
        positions = np.array([record.T_world_camera for record in posed])[:, :3, 3]
        if text := describe_far_frames(far_frames(positions), [record.source_index for record in posed]):
            on_event(Warn(text))
    lost = [r.source_index for r in results if r.record and r.record.T_world_camera is None]
    if lost and recording.has_poses:
        on_event(Warn(f"{len(lost)} of {len(results)} frames have no usable pose; the first is frame {lost[0]}"))


def _renumbered(results: Sequence[FrameResult], staging: RunDirectory) -> list[FrameRecord]:
    """Records of the frames that were kept, numbered without gaps; their files are renamed accordingly."""
    kept = [result.record for result in results if result.record]
    records = []
    with explain_write_errors(staging.root):
        for index, record in enumerate(kept):
            new = record.model_copy(update={"index": index, "color": f"{index:06d}{Path(record.color).suffix}"})
            if index != record.index:
                staging.color_path(record.color).rename(staging.color_path(new.color))
                for sensor in record.sensors:
                    staging.depth_path(sensor, record.index).rename(staging.depth_path(sensor, index))
                    staging.normal_path(sensor, record.index).rename(staging.normal_path(sensor, index))
            records.append(new)
    return records


def _require_usable(
    records: Sequence[FrameRecord], results: Sequence[FrameResult], sensors: Sequence[str], dataset: Path
) -> None:
    if not records:
        reason = next(iter(results[0].skipped.values()))
        raise DataError(f"none of the {len(results)} frames of {dataset} is usable; the first: {reason}")
    blind = [sensor for sensor in sensors if not any(sensor in record.sensors for record in records)]
    if blind:
        others = [sensor for sensor in sensors if sensor not in blind]
        advice = f"; leave it out with --sensors {' '.join(others)}" if others else ""
        reasons = [r.skipped[key] for r in results if (key := f"{r.source_index}/{blind[0]}") in r.skipped]
        why = f" ({reasons[0]})" if reasons and "(" in reasons[0] else ""
        raise DataError(f"sensor {blind[0]} of {dataset} has no valid depth in any frame{why}{advice}")


def _manifest(
    recording: Recording, dataset: Path, sensors: tuple[str, ...], results: Sequence[FrameResult], offset_m: Offset
) -> Manifest:
    return Manifest(
        dataset=str(dataset.resolve()),
        dataset_format=recording.format,
        name=recording.name,
        camera=recording.camera.to_dict(),
        sensors=sensors,
        has_timestamps=recording.has_timestamps,
        reference_mesh=str(recording.reference_mesh.resolve()) if recording.reference_mesh else None,
        registration_sigma_px=recording.registration_sigma_px,
        world_offset_m=offset_m,
        skipped={key: reason for result in results for key, reason in result.skipped.items()},
    )


def _publish(run: RunDirectory, staging: RunDirectory, manifest: Manifest, records: Sequence[FrameRecord]) -> None:
    """Replace the old frames by the new. The manifest without finished stages is written first: an interrupted
    replacement is then recognised as unfinished."""
    run.begin_stage(STAGE, manifest)
    with explain_write_errors(run.root):
        current, replaced = run.frames_path.parent, staging.root / "replaced"
        if current.exists():
            current.rename(replaced)
        staging.frames_path.parent.rename(current)
    posed = [record for record in records if record.T_world_camera is not None]
    if posed:
        poses = np.array([record.T_world_camera for record in posed])
        trajectory = Trajectory(np.array([record.timestamp for record in posed]), poses)
        trajectory.moved(manifest.world_offset_m).save(run.reference_trajectory_path)
    else:
        run.reference_trajectory_path.unlink(missing_ok=True)
