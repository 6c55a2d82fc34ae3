"""How the noise of a sensor grows with distance and slant: as it was learned and, where known, as it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.errors import DataError
from ..run.frames import RunFrames
from .sensor_frames import read_sensor_frame, spread_frames

_FRAMES = 12
_STRIDE = 3  # pixels between the readings that count
_BINS = 16
_FEWEST = 50  # readings that a bin needs


@dataclass(frozen=True)
class NoiseCurve:
    """Means over bins of x. beta, error (B,) metres, NaN where a bin has too few readings; error is None if unknown.

    A Laplace scale is the mean absolute error that it promises, so the two curves of a calibrated sensor coincide.
    """

    x: np.ndarray
    beta: np.ndarray
    error: np.ndarray | None


@dataclass(frozen=True)
class SensorNoise:
    """Against depth in metres, and against the incidence angle in degrees."""

    by_depth: NoiseCurve
    by_incidence: NoiseCurve


@dataclass(frozen=True)
class Readings:
    """Readings of one sensor that have a beta, (N,) each: metres, degrees; NaN where slant or error is unknown."""

    depth: np.ndarray
    incidence: np.ndarray
    beta: np.ndarray
    error: np.ndarray


def collect_readings(frames: RunFrames, sensor: str) -> Readings | None:
    """From a few frames; None where hardly any reading has a beta. Raises DataError."""
    parts = [_readings(frames, index, sensor) for index in spread_frames(frames, sensor, _FRAMES)]
    parts = [part for part in parts if part is not None]
    readings = Readings(*np.concatenate(parts, axis=1)) if parts else None
    return readings if readings is not None and len(readings.depth) >= _FEWEST else None


def sensor_noise(frames: RunFrames, sensor: str) -> SensorNoise | None:
    """The noise curves of one sensor from a few frames; None where it has no beta maps. Raises DataError."""
    readings = collect_readings(frames, sensor)
    return None if readings is None else noise_of(readings)


def noise_of(readings: Readings) -> SensorNoise:
    """The noise curves of a sensor."""
    depth, beta = readings.depth, readings.beta
    known = readings.error if np.isfinite(readings.error).any() else None
    return SensorNoise(
        _binned(depth, beta, known, 0.0, float(np.percentile(depth, 99.5))),
        _binned(readings.incidence, beta, known, 0.0, 90.0),
    )


def _readings(frames: RunFrames, index: int, sensor: str) -> np.ndarray | None:
    """(4, N) depth m, incidence degrees (NaN if unknown), beta m, true error m (NaN if unknown)."""
    row = read_sensor_frame(frames, index, sensor)
    if row.beta is None:
        return None
    try:
        incidence = incidence_angle(frames, index, sensor)
    except DataError:  # the run holds no normals for this sensor
        incidence = np.full(row.depth.shape, np.nan)
    error = row.error if row.error is not None else np.full(row.depth.shape, np.nan)
    columns = np.stack([row.depth, incidence, row.beta, error])[:, ::_STRIDE, ::_STRIDE].reshape(4, -1)
    return columns[:, np.isfinite(columns[0]) & np.isfinite(columns[2])]


def incidence_angle(frames: RunFrames, index: int, sensor: str) -> np.ndarray:
    """(H, W) degrees between the surface normal and the ray back to the camera; NaN where no normal is known."""
    normals = frames.normals(index, sensor).numpy()
    rays = frames.camera.rays().numpy()
    cosine = -(normals * rays).sum(-1) / np.linalg.norm(rays, axis=-1)
    return np.where(normals.any(-1), np.degrees(np.arccos(np.clip(cosine, -1, 1))), np.nan)


def _binned(x: np.ndarray, beta: np.ndarray, error: np.ndarray | None, low: float, high: float) -> NoiseCurve:
    edges = np.linspace(low, max(high, low + 1e-6), _BINS + 1)
    inside = np.isfinite(x) & (x >= low) & (x < edges[-1])
    bins = np.digitize(x[inside], edges) - 1
    return NoiseCurve(
        (edges[:-1] + edges[1:]) / 2, _means(bins, beta[inside]), None if error is None else _means(bins, error[inside])
    )


def _means(bins: np.ndarray, values: np.ndarray) -> np.ndarray:
    known = np.isfinite(values)
    counts = np.bincount(bins[known], minlength=_BINS)
    sums = np.bincount(bins[known], weights=values[known], minlength=_BINS)
    return np.where(counts >= _FEWEST, sums / np.maximum(counts, 1), np.nan)
