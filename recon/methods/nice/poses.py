"""Camera poses as the vector that Adam moves: a quaternion w, x, y, z, and a translation in metres."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor


def to_pose_vector(T_world_camera: np.ndarray) -> Tensor:
    """(..., 4, 4) -> (..., 7) float32."""
    T = np.asarray(T_world_camera, dtype=np.float64)
    x, y, z, w = np.moveaxis(Rotation.from_matrix(T[..., :3, :3].reshape(-1, 3, 3)).as_quat(), -1, 0)
    quaternion = np.stack([w, x, y, z], -1).reshape(*T.shape[:-2], 4)
    return torch.from_numpy(np.concatenate([quaternion, T[..., :3, 3]], -1)).float()


def to_pose_matrix(vectors: Tensor) -> Tensor:
    """(M, 7) -> (M, 4, 4), differentiable; the quaternion need not be of length 1."""
    w, x, y, z = vectors[:, :4].unbind(-1)
    s = 2 / vectors[:, :4].square().sum(-1)
    rows = [
        torch.stack([1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), vectors[:, 4]], -1),
        torch.stack([s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w), vectors[:, 5]], -1),
        torch.stack([s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y), vectors[:, 6]], -1),
    ]
    last = torch.zeros_like(rows[0])
    last[:, 3] = 1
    return torch.stack([*rows, last], 1)


def to_rigid(matrix: Tensor) -> np.ndarray:
    """(4, 4) float32 -> float64 with an exact rotation."""
    T = matrix.detach().cpu().double().numpy()
    T[:3, :3] = Rotation.from_matrix(T[:3, :3]).as_matrix()
    return T
