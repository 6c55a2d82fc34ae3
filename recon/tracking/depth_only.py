"""The pose of a frame in a recording without features: its surface against that of a keyframe, then against the map.

The fused distances draw only from within the truncation band, so a frame that moved further is first brought near by a
keyframe's view of the surface, coarse to fine.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..core.se3 import motion_between
from ..volume.tsdf_volume import TsdfVolume
from .frame_observations import default_beta
from .frame_to_frame import SurfaceView, view_term
from .frame_to_model import SHARE, Readings, agreement, distances, scaled, surface_term
from .pose_estimation import Term, is_weak, minimise, prior_term

MIN_KNOWN, MIN_ON_SURFACE = 0.55, 0.6  # shares of the readings: below, the surface does not confirm a pose
SURE_KNOWN, SURE_ON_SURFACE = 0.7, 0.85  # of a pose that nothing led to
_COARSE_SCALE = 6.0  # of the robust kernel in the first pass against the surface
_EXPECTED_M, _EXPECTED_RAD = 0.02, 0.02  # least uncertainty of a predicted motion
_STRAY_M, _STRAY_RAD = 0.05, 0.05  # by which a lost camera moves, each frame
_ANYWHERE_M, _ANYWHERE_RAD = 0.5, 0.5
_HELD = 0.2  # of the surface's information proves that it shows a motion
_TILT_RAD = 0.07
_PASSES = ((0.1, 4), (0.03, 4), (0.0, 2))  # metres that two views may differ by on top of their noise; step of pixels
_PASS_ITERATIONS = 6


@dataclass(frozen=True)
class SurfacePose:
    """A pose (4, 4) that the map confirms; its information (6, 6), the share `shown` (6, 6) of a motion that the
    surface shows rather than the expectation. `scale`: how far the readings lie from the surface, in sigmas that were
    promised; `fit`: in those of a sensor that is not known, a yardstick that does not change with what is learned."""

    pose: np.ndarray
    information: np.ndarray
    shown: np.ndarray
    scale: float
    fit: float


Keyframe = tuple[SurfaceView, np.ndarray]  # what it sees, and T_world_camera (4, 4)


def expectation(last: np.ndarray, expected: np.ndarray, lost: int = 0) -> Term:
    """What is believed beforehand of a camera that moved from `last` (4, 4): as far again it may be wrong. It was
    `lost` for that many frames since; a motion that was never seen counts as one."""
    step = motion_between(last, expected)
    sigma_m = max(_EXPECTED_M, float(np.linalg.norm(step[:3])), min(lost * _STRAY_M, _ANYWHERE_M))
    sigma_rad = max(_EXPECTED_RAD, float(np.linalg.norm(step[3:])), min(lost * _STRAY_RAD, _ANYWHERE_RAD))
    return _belief(expected, sigma_m, sigma_rad)


def align_to_tsdf(
    volume: TsdfVolume,
    readings: Readings,
    start: np.ndarray,
    prior: Term,
    *,
    tilt_rad: float = 0.0,
    sure: bool = False,
) -> SurfacePose | None:
    """The pose near `start` that brings the readings onto the map; None if the map does not confirm it.

    By as much as normals are off, `tilt_rad`, a plane seems to show a motion along it. `sure`: the surface must do
    without the `prior`, and agree better.
    """
    pose, _ = minimise(start, [surface_term(volume, readings, scale=_COARSE_SCALE), prior])
    readings = scaled(volume, readings, pose)
    surface = surface_term(volume, readings)
    pose, information = minimise(pose, [surface, prior])
    known, agreeing = agreement(volume, readings, pose)
    least = (SURE_KNOWN, SURE_ON_SURFACE) if sure else (MIN_KNOWN, MIN_ON_SURFACE)
    if known < least[0] or agreeing < least[1]:
        return None
    seen = surface(pose).information
    noise = _noise(seen, tilt_rad)
    certain = _less(seen, noise) if tilt_rad else seen
    if sure and is_weak(certain):
        return None
    # Motion must die out where nothing shows it; noise makes even a plain wall seem to hold the camera a little.
    shown = np.linalg.solve(information - (1 - _HELD) * seen + noise, _HELD * seen)
    return SurfacePose(pose, information - (seen - certain), shown, readings.scale, _fit(volume, readings, pose))


def track_from_keyframe(
    volume: TsdfVolume,
    readings: Readings,
    view: SurfaceView,
    keyframe: Keyframe,
    last: np.ndarray,
    expected: np.ndarray,
    lost: int = 0,
) -> Iterator[SurfacePose]:
    """Poses of a frame with this `view`, most likely first: as `expected` (4, 4) of a camera that was at `last`, or as
    if it had stopped there."""
    starts = (expected,) if np.array_equal(expected, last) else (expected, last)
    for start in starts:
        prior = expectation(last, start, lost)
        near = coarse_to_fine_icp(keyframe, view, start, prior)
        around = prior_term(near, prior(start).information)  # what the views showed is not to be taken back
        held = align_to_tsdf(volume, readings, near, around, tilt_rad=_TILT_RAD)
        if held is not None:
            yield held


def relocalise_by_surface(
    volume: TsdfVolume, readings: Readings, view: SurfaceView, keyframes: Sequence[Keyframe]
) -> Iterator[SurfacePose]:
    """Poses of a lost camera with this `view`, as if it stood where one of the `keyframes` was."""
    for keyframe in keyframes:
        near = coarse_to_fine_icp(keyframe, view, keyframe[1], _belief(keyframe[1], _ANYWHERE_M, _ANYWHERE_RAD))
        held = align_to_tsdf(
            volume, readings, near, _belief(near, _ANYWHERE_M, _ANYWHERE_RAD), tilt_rad=_TILT_RAD, sure=True
        )
        if held is not None:
            yield held


def coarse_to_fine_icp(keyframe: Keyframe, view: SurfaceView, start: np.ndarray, prior: Term) -> np.ndarray:
    """T_world_camera (4, 4) near `start` that brings a view and that of a keyframe together; `prior` holds what they do
    not show."""
    target, T_world_target = keyframe
    pose = start
    for apart_m, step in _PASSES:
        source = view.thinned(step).blurred(apart_m)
        term = view_term(target.blurred(apart_m), T_world_target, source, share=SHARE)
        pose, _ = minimise(pose, [term, prior], _PASS_ITERATIONS)
    return pose


def _belief(pose: np.ndarray, sigma_m: float, sigma_rad: float) -> Term:
    return prior_term(pose, np.diag([sigma_m**-2] * 3 + [sigma_rad**-2] * 3))


def _noise(seen: np.ndarray, tilt_rad: float) -> np.ndarray:
    """What of the information `seen` (6, 6) of shifts and of turns noise may feign in any direction."""
    most = [np.linalg.eigvalsh(seen[block, block])[-1] for block in (slice(0, 3), slice(3, 6))]
    return np.diag(np.repeat(most, 3)) * tilt_rad**2


def _less(information: np.ndarray, noise: np.ndarray) -> np.ndarray:
    """(6, 6) without `noise`, nowhere negative."""
    values, vectors = np.linalg.eigh(information - noise)
    rest: np.ndarray = (vectors * np.maximum(values, 0)) @ vectors.T
    return rest


def _fit(volume: TsdfVolume, readings: Readings, pose: np.ndarray) -> float:
    off, which = distances(volume, readings, pose)
    return float((off / default_beta(readings.points[which, 2])).median()) if len(off) else math.inf
