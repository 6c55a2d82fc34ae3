"""The pose of one frame: a robust first guess from matches, then Gauss-Newton over any sum of terms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.camera import Camera
from ..core.se3 import apply_motion, inverse, motion_between
from .observations import Observations, residuals, robust_weights

MIN_INLIERS = 12
_REPROJECTION_PX = 4.0
_RANSAC_ITERATIONS = 300
WEAK_M, WEAK_RAD = 0.02, 0.02  # 1 sigma of the direction that is known least
_UNKNOWN = 1.0
_SMALLEST_STEP = 5e-5  # metres and radians; the adjustments that follow go on from there


@dataclass(frozen=True)
class Linearised:
    """A term at some pose: its cost, information (6, 6) and gradient (6,) by the motion of the camera."""

    cost: float
    information: np.ndarray
    gradient: np.ndarray


Term = Callable[[np.ndarray], Linearised]  # T_world_camera (4, 4) -> its cost there


def minimise(pose: np.ndarray, terms: Sequence[Term], iterations: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Pose (4, 4) of least cost near `pose`, and the information (6, 6) of all terms there.

    Directions that no term sees have no gradient and, by the damping, no step: the pose does not move along them.
    """
    damping = 1e-6
    now = _total(pose, terms)
    for _ in range(iterations):
        scale = np.diag(now.information)
        normal = now.information + np.diag(damping * scale + 1e-9 * scale.max() + 1e-12)
        step = -np.linalg.solve(normal, now.gradient)
        new_pose = apply_motion(pose, step)
        then = _total(new_pose, terms)
        if then.cost < now.cost:
            pose, now, damping = new_pose, then, max(damping / 10, 1e-9)
            if np.abs(step).max() < _SMALLEST_STEP:
                break
        else:  # also where the cost is not a number
            damping = max(damping, 1e-6) * 100
            if damping > 1e4:
                break
    return pose, now.information


def covariance_of(information: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) of a pose; a direction without information has a sigma of `_UNKNOWN` metres or radians."""
    return np.linalg.inv((information + information.T) / 2 + np.eye(6) / _UNKNOWN**2)


def is_weak(information: np.ndarray) -> bool:
    """Whether some direction is known less well than it should."""
    scaled = information * np.outer(*[np.repeat([WEAK_M, WEAK_RAD], 3)] * 2)  # in units where 1 is just good enough
    return bool(np.linalg.eigvalsh(scaled)[0] < 1)


def feature_term(camera: Camera, points: np.ndarray, observations: Observations) -> Term:
    """Pixels and depth readings of landmarks; `observations.point` are rows of `points` (P, 3)."""
    seen = points[observations.point]

    def linearise(pose: np.ndarray) -> Linearised:
        poses = np.broadcast_to(pose, (len(seen), 4, 4))
        r, d_motion, _ = residuals(camera, poses, seen, observations)
        weights, cost = robust_weights(r, observations.share_px)
        weighted = (d_motion * weights[..., None]).reshape(-1, 6)
        return Linearised(cost, weighted.T @ d_motion.reshape(-1, 6), weighted.T @ r.ravel())

    return linearise


def prior_term(expected: np.ndarray, information: np.ndarray) -> Term:
    """How sure one is of `expected` (4, 4) beforehand, as information (6, 6)."""

    def linearise(pose: np.ndarray) -> Linearised:
        off = motion_between(expected, pose)
        return Linearised(float(off @ information @ off), information, information @ off)

    return linearise


def ransac_pose(camera: Camera, points: np.ndarray, uv: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray] | None:
    """T_world_camera (4, 4) and the agreeing matches (K,), from points (N, 3) and pixels (N, 2); None if too few."""
    if len(points) < MIN_INLIERS:
        return None
    cv2.setRNGSeed(seed)
    try:
        found, rotation, translation, inliers = cv2.solvePnPRansac(
            points, uv, camera.matrix, None, iterationsCount=_RANSAC_ITERATIONS, reprojectionError=_REPROJECTION_PX,
            confidence=0.9999, flags=cv2.SOLVEPNP_SQPNP,
        )  # fmt: skip
    except cv2.error:  # degenerate points
        return None
    if not found or inliers is None or len(inliers) < MIN_INLIERS:  # type: ignore[redundant-expr]  # its stubs err
        return None
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3], T_camera_world[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
    return (inverse(T_camera_world), inliers[:, 0]) if np.isfinite(T_camera_world).all() else None


def _total(pose: np.ndarray, terms: Sequence[Term]) -> Linearised:
    parts = [term(pose) for term in terms]
    information, gradient = np.zeros((6, 6)), np.zeros(6)
    return Linearised(
        sum(p.cost for p in parts),
        sum((p.information for p in parts), information),
        sum((p.gradient for p in parts), gradient),
    )
