"""Noise of a sensor against depth and incidence angle: as the map learned it and, where known, as it truly is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.errors import DataError
from ..run.frames import RunFrames
from .sensor_frames import read_sensor_frame, spread_frames


@dataclass(frozen=True)
class NoiseCurveParameters:
    """Which measurements the noise curves are made of.

    frames            number of frames that are sampled, evenly spread
    stride            pixels between the samples of a frame
    bins              bins of depth and of incidence angle
    min_measurements  samples that a bin needs
    """

    frames: int = 12
    stride: int = 3
    bins: int = 16
    min_measurements: int = 50


DEFAULT_PARAMETERS = NoiseCurveParameters()


@dataclass(frozen=True)
class NoiseCurve:
    """Means over bins of x. beta, error (B,) metres, NaN where a bin has too few samples; error is None if unknown.

    A Laplace scale beta is the expected absolute error, so the two curves of a calibrated sensor coincide.
    """

    x: np.ndarray
    beta: np.ndarray
    error: np.ndarray | None


@dataclass(frozen=True)
class SensorNoise:
    """Noise against depth in metres, and against the incidence angle in degrees."""

    by_depth: NoiseCurve
    by_incidence: NoiseCurve


@dataclass(frozen=True)
class BetaSamples:
    """Pixels of one sensor that have a beta, (N,) each: metres and degrees.

    incidence and error are NaN where the normal or the true depth is unknown.
    """

    depth: np.ndarray
    incidence: np.ndarray
    beta: np.ndarray
    error: np.ndarray


def collect_beta_samples(
    frames: RunFrames, sensor: str, parameters: NoiseCurveParameters = DEFAULT_PARAMETERS
) -> BetaSamples | None:
    """Samples of a few frames; None where hardly any pixel has a beta. Raises DataError."""
    indices = spread_frames(frames, sensor, parameters.frames)
    of_frames = (_frame_samples(frames, index, sensor, parameters.stride) for index in indices)
    parts = [part for part in of_frames if part is not None]
    samples = BetaSamples(*np.concatenate(parts, axis=1)) if parts else None
    return samples if samples is not None and len(samples.depth) >= parameters.min_measurements else None


def noise_curves(samples: BetaSamples, parameters: NoiseCurveParameters = DEFAULT_PARAMETERS) -> SensorNoise:
    """The noise curves of a sensor."""
    depth, beta = samples.depth, samples.beta
    error = samples.error if np.isfinite(samples.error).any() else None
    return SensorNoise(
        _binned(depth, beta, error, float(np.percentile(depth, 99.5)), parameters),
        _binned(samples.incidence, beta, error, 90.0, parameters),
    )


def incidence_angle(frames: RunFrames, index: int, sensor: str) -> np.ndarray:
    """(H, W) degrees between the surface normal and the ray back to the camera; NaN where no normal is known."""
    normals = frames.normals(index, sensor).numpy()
    rays = frames.camera.rays().numpy()
    cosine = -(normals * rays).sum(-1) / np.linalg.norm(rays, axis=-1)
    return np.where(normals.any(-1), np.degrees(np.arccos(np.clip(cosine, -1, 1))), np.nan)


def _frame_samples(frames: RunFrames, index: int, sensor: str, stride: int) -> np.ndarray | None:
    """(4, N) depth m, incidence degrees, beta m, true error m of one frame; None without a beta map."""
    frame = read_sensor_frame(frames, index, sensor)
    if frame.beta is None:
        return None
    try:
        incidence = incidence_angle(frames, index, sensor)
    except DataError:  # the run holds no normals for this sensor
        incidence = np.full(frame.depth.shape, np.nan)
    error = frame.error if frame.error is not None else np.full(frame.depth.shape, np.nan)
    columns = np.stack([frame.depth, incidence, frame.beta, error])[:, ::stride, ::stride].reshape(4, -1)
    return columns[:, np.isfinite(columns[0]) & np.isfinite(columns[2])]


def _binned(
    x: np.ndarray, beta: np.ndarray, error: np.ndarray | None, high: float, parameters: NoiseCurveParameters
) -> NoiseCurve:
    """Means of beta and error in equal bins of x from 0 to `high`."""
    edges = np.linspace(0.0, max(high, 1e-6), parameters.bins + 1)
    inside = np.isfinite(x) & (x >= 0.0) & (x < edges[-1])
    bins = np.digitize(x[inside], edges) - 1
    return NoiseCurve(
        (edges[:-1] + edges[1:]) / 2,
        _bin_means(bins, beta[inside], parameters),
        None if error is None else _bin_means(bins, error[inside], parameters),
    )


def _bin_means(bins: np.ndarray, values: np.ndarray, parameters: NoiseCurveParameters) -> np.ndarray:
    known = np.isfinite(values)
    counts = np.bincount(bins[known], minlength=parameters.bins)
    sums = np.bincount(bins[known], weights=values[known], minlength=parameters.bins)
    return np.where(counts >= parameters.min_measurements, sums / np.maximum(counts, 1), np.nan)
