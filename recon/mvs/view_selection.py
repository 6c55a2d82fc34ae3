"""Choice of reference views along the trajectory, and of source views for each of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..core import se3
from ..core.camera import Camera
from ..core.config.uncle import PhotometricConfig
from .multi_view_consistency import view_overlap


@dataclass(frozen=True)
class ViewSelectionParameters:
    """Requirements on the source views of a reference view.

    A source is usable if the triangulation angle, at the distance of the surface, lies between the two limits (a
    smaller one measures no depth, a larger one changes the appearance too much) and it sees at least `min_overlap` of
    the reference. Two sources are at least `min_separation_rad` apart. Sources are ranked by overlap plus angle, of
    which more than `max_ranked_angle_rad` counts no further.
    """

    max_sources: int = 6
    min_sources: int = 2
    min_angle_rad: float = 0.06
    max_angle_rad: float = 0.45
    min_overlap: float = 0.5
    min_separation_rad: float = 0.02
    max_ranked_angle_rad: float = 0.3


class SurfaceDistance(Protocol):
    """The part of `TsdfSurface` that the choice of reference views needs."""

    def median_depth(self, camera: Camera, T_world_camera: np.ndarray) -> float | None:
        """Median z-depth of the surface, metres; None if none is in sight."""
        ...


def choose_reference_frames(
    camera: Camera, poses: Mapping[int, np.ndarray], surface: SurfaceDistance, config: PhotometricConfig
) -> list[int]:
    """Frame indices between which the camera moved or rotated by at least the configured amount, evenly thinned to at
    most `config.max_views`."""
    chosen: list[int] = []
    distance_m = 1.0
    for index in sorted(poses):
        if chosen:
            step = np.linalg.inv(poses[chosen[-1]]) @ poses[index]
            moved = np.linalg.norm(step[:3, 3]) >= config.min_baseline_ratio * distance_m
            if not moved and se3.rotation_angle(step) < config.min_rotation_rad:
                continue
        chosen.append(index)
        distance_m = surface.median_depth(camera, poses[index]) or distance_m
    every = -(-len(chosen) // config.max_views)
    return chosen[:: max(every, 1)]


def choose_sources(
    camera: Camera,
    T_world_camera: np.ndarray,
    reference: int,
    distance_m: float,
    parameters: ViewSelectionParameters = ViewSelectionParameters(),
) -> list[int]:
    """Rows of T_world_camera (N, 4, 4) that are usable as sources of the row `reference`, best first.

    `distance_m` is the distance of the surface from the reference camera.
    """
    poses, T_world_reference = T_world_camera, T_world_camera[reference]
    baseline = np.linalg.norm(poses[:, :3, 3] - T_world_reference[:3, 3], axis=1)
    angle = np.arctan2(baseline, distance_m)
    overlap = view_overlap(camera, poses, T_world_reference, distance_m)
    usable = (angle > parameters.min_angle_rad) & (angle < parameters.max_angle_rad)
    usable &= overlap > parameters.min_overlap
    min_separation_m = parameters.min_separation_rad * distance_m
    chosen: list[int] = []
    for row in np.argsort(-(overlap + np.minimum(angle, parameters.max_ranked_angle_rad)), kind="stable"):
        separation = [np.linalg.norm(poses[row, :3, 3] - poses[other, :3, 3]) for other in chosen]
        if usable[row] and all(distance > min_separation_m for distance in separation):
            chosen.append(int(row))
        if len(chosen) == parameters.max_sources:
            break
    return chosen
