"""Points of the scene that features were found of, and every frame's sightings of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from .observations import Observations

NONE = -1


@dataclass
class FrameFeatures:
    """The features of one frame; `pose` is the present estimate of T_world_camera (4, 4).

    Per feature: uv (N, 2) and sigma_px (N,) pixels; depths and sigmas_m (N, S) metres by sensor, depth 0 = no reading;
    edges (N, S) metres, how much depth differs between the pixels around; noise (N, S, F) what h_w sees there, so that
    sigmas can be had again from what was learned since;
    landmark (N,) int64, NONE where the feature belongs to none. `common_px`: all pixels may be off together by that.
    """

    index: int
    pose: np.ndarray
    uv: np.ndarray
    sigma_px: np.ndarray
    depths: np.ndarray
    sigmas_m: np.ndarray
    edges: np.ndarray
    noise: np.ndarray
    landmark: np.ndarray
    common_px: float = 0.0

    def __len__(self) -> int:
        return len(self.uv)

    def mean_depth(self) -> tuple[np.ndarray, np.ndarray]:
        """(N,) mean of the readings of all sensors by their certainty, 0 = none, and its (N,) sigma; metres."""
        weight = np.where(self.depths > 0, 1 / np.maximum(self.sigmas_m, 1e-4) ** 2, 0.0)
        total = weight.sum(1)
        return (weight * self.depths).sum(1) / np.maximum(total, 1e-12), 1 / np.sqrt(np.maximum(total, 1e-12))

    def forget_unmatched(self) -> None:
        """Keep only the features of landmarks."""
        kept = self.landmark >= 0
        for name in ("uv", "sigma_px", "depths", "sigmas_m", "edges", "noise", "landmark"):
            setattr(self, name, getattr(self, name)[kept])

    def observations(self, rows: np.ndarray, points: np.ndarray, camera: int = 0) -> Observations:
        """Features `rows` (K,) as observations of `points` (K,) by `camera`."""
        return Observations(
            np.full(len(rows), camera), points, self.uv[rows], self.sigma_px[rows], self.depths[rows],
            self.sigmas_m[rows], pixel_information_factor(self.sigma_px[rows], self.common_px),
        )  # fmt: skip

    def to_state(self) -> dict[str, Any]:
        """Plain tensors and numbers."""
        return {n: torch.from_numpy(v) if isinstance(v, np.ndarray) else v for n, v in vars(self).items()}

    @staticmethod
    def from_state(state: dict[str, Any]) -> FrameFeatures:
        """The features of a state."""
        values: dict[str, Any] = {n: v.numpy() if isinstance(v, torch.Tensor) else v for n, v in state.items()}
        return FrameFeatures(**values)


def pixel_information_factor(sigma_px: np.ndarray, common_px: float) -> np.ndarray:
    """(N,) share of its information that each pixel of a frame counts if all are off by `common_px` together: what they
    say in common is then no surer than that, however many they are."""
    return 1 / (1 + len(sigma_px) * (common_px / sigma_px) ** 2)


class Landmarks:
    """Growing tables: points (P, 3) world metres, descriptors (P, 128). Merged landmarks live on under one number."""

    def __init__(self) -> None:
        self.points = np.zeros((0, 3))
        self.descriptors = np.zeros((0, 128), np.float32)
        self.alias = np.zeros(0, np.int64)

    def __len__(self) -> int:
        return len(self.points)

    def add(self, points: np.ndarray, descriptors: np.ndarray) -> np.ndarray:
        """Numbers (N,) of the new landmarks."""
        numbers = np.arange(len(self), len(self) + len(points))
        self.points = np.concatenate([self.points, points])
        self.descriptors = np.concatenate([self.descriptors, descriptors])
        self.alias = np.concatenate([self.alias, numbers])
        return numbers

    def merge(self, gone: np.ndarray, kept: np.ndarray) -> None:
        """Landmarks `gone` (N,) are the same points as `kept` (N,)."""
        for source, target in zip(gone, kept, strict=True):
            self.alias[self.alias == self.alias[source]] = self.alias[target]

    def current(self, numbers: np.ndarray) -> np.ndarray:
        """The numbers under which `numbers` live on; NONE stays."""
        return np.where(numbers >= 0, self.alias[numbers], NONE) if len(self) else numbers

    def seen_by(self, frame_features: FrameFeatures) -> np.ndarray:
        """Numbers (K,) of the landmarks of a frame, distinct, increasing."""
        current = self.current(frame_features.landmark)
        return np.unique(current[current >= 0])


def observations_of(frames: list[FrameFeatures], landmarks: Landmarks) -> tuple[Observations, np.ndarray]:
    """Observations of those frames, cameras numbered as in the list and points 0..P; and the landmark (P,) of each."""
    parts = []
    for position, frame_features in enumerate(frames):
        number = landmarks.current(frame_features.landmark)
        _, first = np.unique(number, return_index=True)  # a point is seen once in an image
        rows = first[number[first] >= 0]
        parts.append(frame_features.observations(rows, number[rows], position))
    columns = [np.concatenate([getattr(p, name) for p in parts]) for name in Observations.__dataclass_fields__]
    joined = Observations(*columns)
    numbers, points = np.unique(joined.point, return_inverse=True)
    return joined.with_points(points), numbers


def seen_at_least(observations: Observations, times: int) -> np.ndarray:
    """(M,) which observations are of a point that `times` cameras saw."""
    return np.bincount(observations.point)[observations.point] >= times if len(observations) else np.zeros(0, bool)
