"""Frames that lie where no frame around them expects them, placed again from where they are expected.

A frame that is placed on landmarks by itself can end in a wrong minimum: its depth did not arrive, or its image is that
of the frame before and was matched where the camera was thought to be. The frames around know better.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..core.camera import Camera
from ..core.se3 import apply_motion, motion_between
from .bundle_adjustment import adjust
from .observations import Observations, residuals, robust_weights, without_outliers

AROUND = ((-1, 1), (-2, 2), (-2, -1), (1, 2))  # pairs of neighbours that tell where a frame between or beside them is
NEAR = 3  # frames: neighbours that are further away tell nothing
SURPRISE = 10.0  # usual distances from what is expected
PRIOR_COST_PER_OBSERVATION = 4.0  # cost of a reading that half fits: what is expected counts no more than that for each
_SMALLEST = (5e-4, 5e-4)  # metres and radians: usual distances are taken to be no less
_LEAST_FRAMES = 10  # that tell how a camera usually moves
_LEAST_READINGS = 12  # that place a frame
_LIMITS = (15.0, 5.0)  # sigmas: observations beyond are left out, first and then
_ITERATIONS = 10


def reoptimise_outliers(
    camera: Camera,
    poses: np.ndarray,
    times: np.ndarray,
    points: np.ndarray,
    observations: Observations,
    free: np.ndarray,
) -> np.ndarray:
    """Poses (C, 4, 4) of frames with increasing numbers `times` (C,), of which surprising ones that are `free` (C,) may
    have gone to where they fit better.

    points (P, 3) hold still. A pose costs its residuals, and the square of its distance from what is expected in units
    of the usual one, as far as that may outvote readings: a jerk that they confirm stays.
    """
    if len(poses) < _LEAST_FRAMES:
        return poses
    expected = expectations(poses, times)
    off = nearest(poses, expected)
    known = np.isfinite(off[:, 0])
    if not known.any():
        return poses
    usual = np.maximum(np.median(off[known], axis=0), _SMALLEST)
    surprising = free & known & (np.linalg.norm(off / usual, axis=-1) > SURPRISE)
    result = poses.copy()
    for frame in np.flatnonzero(surprising):
        seen = observations[observations.camera == frame]
        seen = replace(seen, camera=np.zeros(len(seen), np.int64))
        here = expected[:, frame][np.isfinite(expected[:, frame, 0, 0])]
        result[frame] = _best(camera, poses[frame], here, points, seen, usual)
    return result


def expectations(poses: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Where each pair of neighbours has each frame, at constant speed: (4, C, 4, 4), NaN where there is none."""
    count = len(poses)
    expected = np.full((len(AROUND), count, 4, 4), np.nan)
    for n, (first, second) in enumerate(AROUND):
        here = np.arange(max(0, -first), count - max(0, second))
        a, b = here + first, here + second
        near = (np.abs(times[a] - times[here]) <= NEAR) & (np.abs(times[b] - times[here]) <= NEAR)
        here, a, b = here[near], a[near], b[near]
        share = (times[here] - times[a]) / (times[b] - times[a])
        expected[n, here] = apply_motion(poses[a], share[:, None] * motion_between(poses[a], poses[b]))
    return expected


def nearest(poses: np.ndarray, expected: np.ndarray) -> np.ndarray:
    """(C, 2) metres and radians between poses (C, 4, 4) and the nearest of where they are expected, each for itself;
    infinite where nothing is."""
    known = np.isfinite(expected[..., 0, 0])
    off = np.full((*known.shape, 2), np.inf)
    motions = motion_between(np.broadcast_to(poses, expected.shape)[known], expected[known]).reshape(-1, 2, 3)
    off[known] = np.linalg.norm(motions, axis=-1)
    smallest: np.ndarray = off.min(axis=0)
    return smallest


def _best(
    camera: Camera,
    pose: np.ndarray,
    expected: np.ndarray,
    points: np.ndarray,
    seen: Observations,
    usual: np.ndarray,
) -> np.ndarray:
    """The pose (4, 4) of least cost: `pose`, or what readings make of those `expected` (K, 4, 4)."""
    best, least, most = (
        pose,
        pose_cost(camera, pose, expected, points, seen, usual),
        _agreeing(camera, pose, points, seen),
    )
    for start in expected:
        found = start
        for limit in _LIMITS:
            kept = without_outliers(camera, found[None], points, seen, limit)
            if len(kept) < _LEAST_READINGS:
                break
            found = adjust(camera, found[None], points, kept, np.ones(1, bool), free_points=False,
                           iterations=_ITERATIONS).poses[0]  # fmt: skip
        agreeing = _agreeing(camera, found, points, seen)
        cost = pose_cost(camera, found, expected, points, seen, usual)
        if agreeing >= max(_LEAST_READINGS, most / 2) and cost < least:
            best, least = found, cost
    return best


def _agreeing(camera: Camera, pose: np.ndarray, points: np.ndarray, seen: Observations) -> int:
    return len(without_outliers(camera, pose[None], points, seen, _LIMITS[-1]))


def pose_cost(
    camera: Camera,
    pose: np.ndarray,
    expected: np.ndarray,
    points: np.ndarray,
    seen: Observations,
    usual: np.ndarray,
) -> float:
    """Robust cost of what a frame saw of points at a `pose` (4, 4), and of its distance from where it is `expected`
    (K, 4, 4), in units of the `usual` distance (2,) and at most as much as the observations may outvote."""
    off = np.linalg.norm(nearest(pose[None], expected[:, None])[0] / usual)
    r, _, _ = residuals(camera, pose[None][seen.camera], points[seen.point], seen)
    return robust_weights(r, seen.share_px)[1] + min(float(off**2), PRIOR_COST_PER_OBSERVATION * len(seen))
