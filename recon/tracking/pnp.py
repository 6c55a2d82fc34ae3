"""The pose of a frame from matches of its features to landmarks: RANSAC first, then all that agree."""

from __future__ import annotations

import cv2
import numpy as np

from ..camera import Camera
from .bundle_adjustment import Observations, adjust, without_outliers
from .motion import inverse

MIN_INLIERS = 12
_REPROJECTION_PX = 4.0
_ITERATIONS = 300
_LIMIT = 4.0  # sigmas


def ransac_pose(camera: Camera, points: np.ndarray, uv: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray] | None:
    """T_world_camera (4, 4) and the agreeing matches (K,), from points (N, 3) and pixels (N, 2); None if too few."""
    if len(points) < MIN_INLIERS:
        return None
    cv2.setRNGSeed(seed)
    found, rotation, translation, inliers = cv2.solvePnPRansac(
        points, uv, camera.matrix, None, iterationsCount=_ITERATIONS, reprojectionError=_REPROJECTION_PX,
        confidence=0.9999, flags=cv2.SOLVEPNP_SQPNP,
    )  # fmt: skip
    if not found or inliers is None or len(inliers) < MIN_INLIERS:
        return None
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3], T_camera_world[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
    return (inverse(T_camera_world), inliers[:, 0]) if np.isfinite(T_camera_world).all() else None


def refined_pose(
    camera: Camera,
    pose: np.ndarray,
    points: np.ndarray,
    observations: Observations,
    prior: tuple[np.ndarray, np.ndarray] | None = None,
    iterations: int = 8,
) -> tuple[np.ndarray, np.ndarray]:
    """Pose (4, 4) from observations of one camera (all `camera` 0, `point` a row of points (P, 3)), and information
    (6, 6). `prior`: expected pose (4, 4) and information of it (6, 6)."""
    stacked = None if prior is None else (prior[0][None], prior[1][None])
    adjusted = adjust(
        camera, pose[None], points, observations, np.ones(1, bool), free_points=False, iterations=iterations,
        prior=stacked,
    )  # fmt: skip
    return adjusted.poses[0], adjusted.information[0]


def agreeing(camera: Camera, pose: np.ndarray, points: np.ndarray, observations: Observations) -> Observations:
    """The observations of one camera that `pose` (4, 4) explains."""
    return without_outliers(camera, pose[None], points, observations, _LIMIT)
