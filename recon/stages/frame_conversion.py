"""Conversion of one frame of a recording into the files of one frame of a run."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..core.errors import FrameError
from ..core.files import DEPTH_UNITS_PER_M, encode_metres, write_image
from ..core.frame import Recording
from ..core.normals import normals, smooth_depth
from ..run.directory import RunDirectory
from ..run.frames import encode_normals
from ..run.manifest import FrameRecord

MAX_DEPTH_M = 65535 / DEPTH_UNITS_PER_M  # what a 16-bit image of millimetres can hold


@dataclass(frozen=True)
class FrameResult:
    """Result of converting one frame: `record` is None if it was skipped; `digest` of the images of the others."""

    source_index: int
    record: FrameRecord | None
    skipped: dict[str, str]  # as in Manifest.skipped
    digest: str = ""


@dataclass(frozen=True)
class FrameConverter:
    """Converts one frame at a time; several threads may use it at once."""

    recording: Recording
    sensors: tuple[str, ...]
    color_suffix: str

    def __call__(self, staging: RunDirectory, index: int, source_index: int) -> FrameResult:
        """Write the images of frame `source_index` under the number `index`."""
        skipped: dict[str, str] = {}
        try:
            color = self.recording.color(source_index).numpy()
        except FrameError as error:
            return FrameResult(source_index, None, {str(source_index): str(error)})
        depths: dict[str, np.ndarray] = {}
        reasons: dict[str, str] = {}
        for sensor in self.sensors:
            try:
                depth = self.recording.depth(source_index, sensor).numpy()
                depths[sensor] = cleaned_depth(depth)
                if not depths[sensor].any():
                    reasons[sensor] = reason_without_depth(depth)
            except FrameError as error:
                skipped[f"{source_index}/{sensor}"] = str(error)
        if not depths:
            return FrameResult(source_index, None, {str(source_index): "; ".join(skipped.values())})
        valid = {sensor: depth for sensor, depth in depths.items() if sensor not in reasons}
        skipped |= {f"{source_index}/{sensor}": reason for sensor, reason in reasons.items()}
        record = self._record(index, source_index, tuple(valid))
        write_image(staging.color_path(record.color), color)
        for sensor, depth in valid.items():
            self._write_sensor(staging, sensor, index, depth)
        return FrameResult(source_index, record, skipped, _digest((color, *valid.values())))

    def _record(self, index: int, source_index: int, sensors: tuple[str, ...]) -> FrameRecord:
        pose = self.recording.pose(source_index)
        return FrameRecord(
            index=index,
            source_index=source_index,
            timestamp=self.recording.timestamp(source_index),
            color=f"{index:06d}{self.color_suffix}",
            sensors=sensors,
            T_world_camera=pose.tolist() if pose is not None and np.isfinite(pose).all() else None,
        )

    def _write_sensor(self, staging: RunDirectory, sensor: str, index: int, depth: np.ndarray) -> None:
        write_image(staging.depth_path(sensor, index), encode_metres(depth, DEPTH_UNITS_PER_M))
        directions = normals(smooth_depth(depth), self.recording.camera)
        write_image(staging.normal_path(sensor, index), encode_normals(directions))


def _digest(images: Iterable[np.ndarray]) -> str:
    """Digest of the content of some images."""
    digest = hashlib.sha256()
    for image in images:
        digest.update(np.ascontiguousarray(image).tobytes())
    return digest.hexdigest()


def cleaned_depth(depth: np.ndarray) -> np.ndarray:
    """(H, W) float32 metres, with 0 for invalid depth: not finite, negative, or too far to be stored."""
    return np.where((depth > 0.5 / DEPTH_UNITS_PER_M) & (depth < MAX_DEPTH_M), depth, np.float32(0.0))


def reason_without_depth(depth: np.ndarray) -> str:
    """Why no measurement of an image (H, W) in metres is valid, in case none is: a depth scale is easily inverted."""
    measured = depth[np.isfinite(depth) & (depth > 0)]
    if not measured.size:
        return "no valid depth"
    median = float(np.median(measured))
    side = f"beyond {MAX_DEPTH_M:.0f} m" if median > 1 else "nearer than a millimetre"
    return f"no valid depth: its measurements are {side} (median {median:.4g} m), so depth_scale is not right"
