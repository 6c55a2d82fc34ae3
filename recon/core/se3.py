"""Rigid transforms and small motions.

A motion x (6,) is 3 of translation, metres, then 3 of rotation, radians, in the axes of the camera that moves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation


def apply_motion(T_world_camera: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """(..., 4, 4) poses, (..., 6) motions -> T_world_camera @ [exp(rotation) | translation], (..., 4, 4)."""
    step = np.zeros((*motion.shape[:-1], 4, 4))
    rotations = Rotation.from_rotvec(motion[..., 3:].reshape(-1, 3)).as_matrix()
    step[..., :3, :3] = rotations.reshape(*motion.shape[:-1], 3, 3)
    step[..., :3, 3], step[..., 3, 3] = motion[..., :3], 1.0
    return T_world_camera @ step


def motion_between(T_world_first: np.ndarray, T_world_second: np.ndarray) -> np.ndarray:
    """The motion (..., 6) that takes the first poses (..., 4, 4) to the second: the inverse of `apply_motion`."""
    step = inverse(T_world_first) @ T_world_second
    rotations = Rotation.from_matrix(step[..., :3, :3].reshape(-1, 3, 3)).as_rotvec()
    return np.concatenate([step[..., :3, 3], rotations.reshape(*step.shape[:-2], 3)], -1)


def inverse(poses: np.ndarray) -> np.ndarray:
    """Inverse of rigid transforms (..., 4, 4)."""
    transposed = np.swapaxes(poses[..., :3, :3], -1, -2)
    result = np.zeros_like(poses)
    result[..., :3, :3] = transposed
    result[..., :3, 3] = -(transposed @ poses[..., :3, 3:])[..., 0]
    result[..., 3, 3] = 1.0
    return result


def transform(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Rigid transforms (..., 4, 4) of points (..., 3)."""
    moved: np.ndarray = (poses[..., :3, :3] @ points[..., None])[..., 0] + poses[..., :3, 3]
    return moved


def rotation_angle(transforms: np.ndarray) -> np.ndarray:
    """Rotation angle of rigid transforms (..., 4, 4) or rotations (..., 3, 3): (...) radians from 0 to pi.

    From sine and cosine, because the arc cosine alone is inexact for small angles.
    """
    rotations = transforms[..., :3, :3]
    differences = rotations - np.swapaxes(rotations, -1, -2)
    sine = 0.5 * np.linalg.norm(differences[..., [2, 0, 1], [1, 2, 0]], axis=-1)
    angles: np.ndarray = np.arctan2(sine, 0.5 * (np.trace(rotations, axis1=-2, axis2=-1) - 1.0))
    return angles


def exceeds(transform: np.ndarray, metres: float, radians: float) -> bool:
    """Whether a rigid transform (4, 4) translates or rotates by more than the limits."""
    return bool(np.linalg.norm(transform[:3, 3]) > metres or rotation_angle(transform) > radians)


def predict_pose(recent: Sequence[np.ndarray]) -> np.ndarray:
    """T_world_camera (4, 4) after the latest of the `recent` poses, for a camera of constant velocity.

    That is T_{t-1} T_{t-2}^-1 T_{t-1}; the latest pose itself if only one is known.
    """
    if len(recent) < 2:
        return recent[-1]
    predicted: np.ndarray = recent[-1] @ inverse(recent[-2]) @ recent[-1]
    return predicted


def adjoint(transforms: np.ndarray) -> np.ndarray:
    """(..., 4, 4) T_a_b -> (..., 6, 6) that takes small motions in the axes of b to those of a.

    T exp(x) = exp(Ad x) T to first order, translation first.
    """
    rotations = transforms[..., :3, :3]
    result = np.zeros((*transforms.shape[:-2], 6, 6))
    result[..., :3, :3] = result[..., 3:, 3:] = rotations
    result[..., :3, 3:] = cross_matrix(transforms[..., :3, 3]) @ rotations
    return result


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3), so that cross_matrix(a) @ b = a x b."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, -2)
