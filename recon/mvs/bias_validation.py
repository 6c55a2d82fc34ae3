"""Validation of bias models by the consistency of a sensor's own views, without any reference."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np
from torch import Tensor

from ..core.camera import Camera
from .multi_view_consistency import ConsistencyParameters, cross_view_residual


class Validation(Enum):
    """Result of a consistency test."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    UNDECIDED = "undecided"


@dataclass(frozen=True)
class ConsistencyTestParameters:
    """Constants of the cross-view consistency test.

    samples_per_view: pixels of a view that are compared; min_observing_views: views that must see a pixel; min_samples:
    compared pixels for a view to count; min_views: counting views for a result; residual_offset_m: added to both
    residuals, so that ratios of tiny residuals do not decide; accepted_fraction, rejected_fraction: a correction is
    accepted from this fraction of improved views on, and rejected up to that one; views: number of views tested.
    """

    views: int = 40
    samples_per_view: int = 1500
    min_observing_views: int = 3
    min_samples: int = 100
    min_views: int = 3
    residual_offset_m: float = 1e-3
    accepted_fraction: float = 0.75
    rejected_fraction: float = 0.25
    consistency: ConsistencyParameters = field(default_factory=ConsistencyParameters)

    def result(self, improved_fraction: float | None) -> Validation:
        """The result for a fraction of improved views; None = too few views for a fraction."""
        if improved_fraction is None:
            return Validation.UNDECIDED
        if improved_fraction >= self.accepted_fraction:
            return Validation.ACCEPTED
        return Validation.REJECTED if improved_fraction <= self.rejected_fraction else Validation.UNDECIDED


CONSISTENCY_TEST = ConsistencyTestParameters()


@dataclass(frozen=True)
class DepthView:
    """depth (H, W) metres, 0 = no measurement, and the pose T_world_camera (4, 4)."""

    depth: np.ndarray
    T_world_camera: np.ndarray


class CrossViewConsistencyTest:
    """Compares the cross-view residuals of one sensor before and after bias correction.

    A bias that depends on the image content, such as the distance, makes views of the same surface inconsistent. The
    right correction reduces the residuals between views, a wrong one increases them.
    """

    def __init__(self, parameters: ConsistencyTestParameters = CONSISTENCY_TEST) -> None:
        self.parameters = parameters
        self.raw: list[DepthView] = []
        self.corrected: list[DepthView] = []

    def add(self, depth: Tensor, corrected: Tensor, T_world_camera: np.ndarray) -> None:
        """Add a view: depth (H, W) metres as measured and corrected."""
        self.raw.append(DepthView(depth.cpu().numpy(), T_world_camera))
        self.corrected.append(DepthView(corrected.cpu().numpy(), T_world_camera))

    def improved_fraction(self, camera: Camera, seed: int) -> float | None:
        """Fraction of the views whose residuals to the others fall by the correction; None if there are too few."""
        parameters, rng = self.parameters, np.random.default_rng(seed)
        gains = []
        for view in range(len(self.raw)):
            pixels = np.flatnonzero((self.raw[view].depth > 0) & (self.corrected[view].depth > 0))
            pixels = rng.choice(pixels, min(parameters.samples_per_view, len(pixels)), replace=False)
            before, count_before = cross_view_residual(camera, self.raw, view, pixels, parameters.consistency)
            after, count_after = cross_view_residual(camera, self.corrected, view, pixels, parameters.consistency)
            used = np.minimum(count_before, count_after) >= parameters.min_observing_views
            if used.sum() >= parameters.min_samples:
                offset = parameters.residual_offset_m
                gains.append(np.log((before[used] + offset) / (after[used] + offset)).mean())
        return float(np.mean(np.array(gains) > 0)) if len(gains) >= parameters.min_views else None
