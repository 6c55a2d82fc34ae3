"""Points of the scene that features were found of, and every frame's sightings of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .bundle_adjustment import Observations
from .local_features import LocalFeatures

NONE = -1


@dataclass
class Sighting:
    """What one frame saw. landmark (N,) int64 for each feature, NONE where it belongs to none; depths and sigmas_m
    (N, S) metres by sensor, depth 0 = no reading; `pose` the current estimate of T_world_camera."""

    index: int
    pose: np.ndarray
    features: LocalFeatures
    depths: np.ndarray
    sigmas_m: np.ndarray
    landmark: np.ndarray
    noise_features: np.ndarray | None = None  # (N, S, F), so that sigmas can be had again from what was learned since

    def mean_depth(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) mean of the readings of all sensors by their certainty, 0 = none, and its (N,) sigma; metres."""
        weight = np.where(self.depths > 0, 1 / np.maximum(self.sigmas_m, 1e-4) ** 2, 0.0)
        total = weight.sum(1)
        depth = (weight * self.depths).sum(1) / np.maximum(total, 1e-12)
        return depth, 1 / np.sqrt(np.maximum(total, 1e-12))


class Landmarks:
    """Growing tables: points (P, 3) world metres, descriptors (P, 128). Merged landmarks live on under one number."""

    def __init__(self) -> None:
        self.points = np.zeros((0, 3))
        self.descriptors = np.zeros((0, 128), np.float32)
        self._alias = np.zeros(0, np.int64)

    def __len__(self) -> int:
        return len(self.points)

    def add(self, points: np.ndarray, descriptors: np.ndarray) -> np.ndarray:
        """Numbers (N,) of the new landmarks."""
        numbers = np.arange(len(self), len(self) + len(points))
        self.points = np.concatenate([self.points, points])
        self.descriptors = np.concatenate([self.descriptors, descriptors])
        self._alias = np.concatenate([self._alias, numbers])
        return numbers

    def merge(self, gone: np.ndarray, kept: np.ndarray) -> None:
        """Landmarks `gone` (N,) are the same points as `kept` (N,)."""
        for source, target in zip(self.current(gone), self.current(kept), strict=True):
            self._alias[self._alias == source] = target

    def current(self, numbers: np.ndarray) -> np.ndarray:
        """The numbers under which `numbers` live on; NONE stays."""
        return np.where(numbers >= 0, self._alias[numbers], NONE) if len(self) else numbers


def observations_of(sightings: list[Sighting], landmarks: Landmarks) -> tuple[Observations, np.ndarray]:
    """Observations of those frames, cameras numbered as in the list and points 0..P; and the landmark (P,) of each."""
    cameras, numbers, parts = [], [], []
    for position, sighting in enumerate(sightings):
        number = landmarks.current(sighting.landmark)
        seen = np.flatnonzero(number >= 0)
        _, first = np.unique(number[seen], return_index=True)  # a point is seen once in an image
        seen = seen[first]
        cameras.append(np.full(len(seen), position))
        numbers.append(number[seen])
        parts.append((sighting, seen))
    used, points = np.unique(np.concatenate(numbers), return_inverse=True)
    return (
        Observations(
            np.concatenate(cameras),
            points,
            np.concatenate([s.features.uv[k] for s, k in parts]),
            np.concatenate([s.features.sigma_px[k] for s, k in parts]),
            np.concatenate([s.depths[k] for s, k in parts]),
            np.concatenate([s.sigmas_m[k] for s, k in parts]),
        ),
        used,
    )


def seen_at_least(observations: Observations, times: int) -> np.ndarray:
    """(M,) which observations are of a point that `times` cameras saw."""
    return np.bincount(observations.point)[observations.point] >= times


def with_sigmas(sighting: Sighting, sigmas_m: np.ndarray) -> Sighting:
    return replace(sighting, sigmas_m=sigmas_m)
