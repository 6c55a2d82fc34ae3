"""Frames that lie where no frame around them expects them, placed again from where they are expected.

A frame that is placed on landmarks by itself can end in a wrong minimum: its depth did not arrive, or its image is that
of the frame before and was matched where the camera was thought to be. The frames around know better.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..camera import Camera
from .bundle_adjustment import Observations, adjust, costs_by_camera, without_outliers
from .motion import motion_between, moved

AROUND = ((-1, 1), (-2, 2), (-2, -1), (1, 2))  # pairs of neighbours that tell where a frame between or beside them is
SURPRISE = 10.0  # usual distances from what is expected
_SMALLEST = (5e-4, 5e-4)  # metres and radians: usual distances are taken to be no less
_LIMITS = (15.0, 5.0)  # sigmas: observations beyond are left out, first and then
_ITERATIONS = 10


def placed_again(
    camera: Camera, poses: np.ndarray, times: np.ndarray, points: np.ndarray, observations: Observations
) -> np.ndarray:
    """Poses (C, 4, 4) at increasing `times` (C,), of which surprising ones may have gone to where they fit better.

    points (P, 3) hold still. A pose costs its residuals and the square of its distance from what is expected, in units
    of the usual one.
    """
    expected = expectations(poses, times)
    off = distances(poses, expected)
    usual = np.maximum(np.nanmedian(np.nanmin(off, axis=0), axis=0), _SMALLEST)
    frames = np.flatnonzero(surprise(off, usual) > SURPRISE)
    if len(frames) == 0:
        return poses
    position = np.full(len(poses), -1)
    position[frames] = np.arange(len(frames))
    seen = observations[position[observations.camera] >= 0]
    seen = replace(seen, camera=position[seen.camera])
    best = poses[frames]
    least = _cost(camera, best, points, seen, expected[:, frames], usual)
    for start in expected[:, frames]:
        found = np.where(np.isfinite(start), start, best)
        for limit in _LIMITS:
            kept = without_outliers(camera, found, points, seen, limit)
            free = np.isin(np.arange(len(frames)), kept.camera)
            found = adjust(camera, found, points, kept, free, free_points=False, iterations=_ITERATIONS).poses
        cost = _cost(camera, found, points, seen, expected[:, frames], usual)
        better = cost < least
        best, least = np.where(better[:, None, None], found, best), np.where(better, cost, least)
    result = poses.copy()
    result[frames] = best
    return result


def expectations(poses: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Where each pair of neighbours has each frame, at constant speed: (4, C, 4, 4), NaN where one is missing."""
    count = len(poses)
    expected = np.full((len(AROUND), count, 4, 4), np.nan)
    for n, (first, second) in enumerate(AROUND):
        here = np.arange(max(0, -first), count - max(0, second))
        a, b = here + first, here + second
        share = (times[here] - times[a]) / (times[b] - times[a])
        expected[n, here] = moved(poses[a], share[:, None] * motion_between(poses[a], poses[b]))
    return expected


def distances(poses: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(4, C, 2) metres and radians between poses (C, 4, 4) and where they are expected; NaN where nothing is."""
    known = np.isfinite(expected[..., 0, 0])
    off = np.full((*known.shape, 2), np.nan)
    motions = motion_between(np.broadcast_to(poses, expected.shape)[known], expected[known]).reshape(-1, 2, 3)
    off[known] = np.linalg.norm(motions, axis=-1)
    return off


def surprise(off: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """(C,) distance from the nearest of what is expected, in units of `usual` (2,); 0 where nothing is."""
    scaled = np.linalg.norm(off / usual, axis=-1)
    return np.where(np.isfinite(scaled).any(axis=0), np.nan_to_num(scaled, nan=np.inf).min(axis=0), 0.0)


def _cost(camera, poses, points, observations, expected, usual) -> np.ndarray:
    """(C,)."""
    return costs_by_camera(camera, poses, points, observations) + surprise(distances(poses, expected), usual) ** 2
