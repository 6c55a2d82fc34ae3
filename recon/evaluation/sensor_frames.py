"""Depth, error scale and true error of one sensor in one frame of a run."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.frame import GROUND_TRUTH_SENSOR
from ..run.frames import RunFrames


@dataclass(frozen=True)
class SensorFrame:
    """One sensor in one frame: depth, beta, |error| (H, W) metres, NaN where unknown.

    beta and error are None where the frame has no beta map or no true depth.
    """

    index: int
    depth: np.ndarray
    beta: np.ndarray | None
    error: np.ndarray | None


def estimated_sensors(frames: RunFrames) -> list[str]:
    """The sensors of a run without the ground truth."""
    return [sensor for sensor in frames.sensors if sensor != GROUND_TRUTH_SENSOR]


def read_sensor_frame(frames: RunFrames, index: int, sensor: str) -> SensorFrame:
    """Depth, beta and true error of one sensor in one frame. Raises DataError."""
    depth = _nan_where_missing(frames.depth(index, sensor).numpy())
    has_beta = frames.run.beta_path(sensor, index).is_file()
    beta = _nan_where_missing(frames.beta(index, sensor).numpy()) if has_beta else None
    has_truth = GROUND_TRUTH_SENSOR in frames.records[index].sensors and sensor != GROUND_TRUTH_SENSOR
    error = None
    if has_truth:
        error = np.abs(depth - _nan_where_missing(frames.depth(index, GROUND_TRUTH_SENSOR).numpy()))
    return SensorFrame(index, depth, beta, error)


def spread_frames(frames: RunFrames, sensor: str, count: int) -> list[int]:
    """Up to `count` frames with an image of `sensor`, evenly spread; only those with a beta map if there are any."""
    with_depth = [record.index for record in frames.records if sensor in record.sensors]
    with_beta = [index for index in with_depth if frames.run.beta_path(sensor, index).is_file()]
    usable = with_beta or with_depth
    return [usable[round(p)] for p in np.linspace(0, len(usable) - 1, min(count, len(usable)))] if usable else []


def _nan_where_missing(values: np.ndarray) -> np.ndarray:
    return np.where(values > 0, values, np.nan)
