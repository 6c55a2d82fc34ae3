"""Small rigid motions. A motion x (6,) is 3 of translation, metres, then 3 of rotation, radians, in camera axes."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def moved(T_world_camera: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """(..., 4, 4) poses, (..., 6) motions -> T_world_camera @ [exp(rotation) | translation], (..., 4, 4)."""
    step = np.zeros((*motion.shape[:-1], 4, 4))
    rotations = Rotation.from_rotvec(motion[..., 3:].reshape(-1, 3)).as_matrix()
    step[..., :3, :3] = rotations.reshape(*motion.shape[:-1], 3, 3)
    step[..., :3, 3], step[..., 3, 3] = motion[..., :3], 1.0
    return T_world_camera @ step


def motion_between(T_world_first: np.ndarray, T_world_second: np.ndarray) -> np.ndarray:
    """The motion (..., 6) that takes the first poses (..., 4, 4) to the second: the inverse of `moved`."""
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
    return (poses[..., :3, :3] @ points[..., None])[..., 0] + poses[..., :3, 3]


def angle(poses: np.ndarray) -> np.ndarray:
    """How far rigid transforms (..., 4, 4) turn, (...) radians."""
    return np.arccos(np.clip((np.trace(poses[..., :3, :3], axis1=-2, axis2=-1) - 1) / 2, -1, 1))


def exceeds(transform: np.ndarray, metres: float, radians: float) -> bool:
    """Whether a rigid transform (4, 4) shifts or turns by more than that."""
    return bool(np.linalg.norm(transform[:3, 3]) > metres or angle(transform) > radians)


def cross_matrix(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3), so that cross_matrix(a) @ b = a x b."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))]
    return np.stack(rows, -2)
