"""One camera pose as a file states it: checked, corrected where it can be meant in one way only, or with a reason."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

ORTHONORMAL_TOLERANCE = 2e-2  # two decimals, rounded; anything beyond is no rotation
NORM_TOLERANCE = 0.05  # of quaternions in text
EXACT_TOLERANCE = 1e-3  # a rotation that is off by more is corrected with a remark
MAX_SCALE = 1.1  # of a rotation, or its inverse; more is another unit of length, not an alignment that fitted a scale
MAX_POSITION_M = 1e9  # further than any place on Earth, in millimetres too: the file is damaged


@dataclass(frozen=True)
class Pose:
    """T_world_camera (4, 4) float64 with an exact rotation, or None if it cannot be used.

    `remark` says why it cannot be used, or how it was corrected; empty if there is nothing to report.
    """

    T_world_camera: np.ndarray | None = None
    remark: str = ""

    def located(self, where: str) -> Pose:
        """The same pose; its remark begins with `where` it was found."""
        return replace(self, remark=f"{where}: {self.remark}") if self.remark else self


NO_POSE = Pose()


def usable_pose(matrix: np.ndarray) -> Pose:
    """The pose that a (4, 4) or (3, 4) matrix states, T_world_camera.

    A rotation that is rounded or carries a scale near 1 is corrected, a transposed matrix is transposed back.
    """
    if not np.isfinite(matrix).all():
        kinds = "nan" if np.isnan(matrix).any() else "infinite"
        return Pose(None, f"its numbers are not finite ({kinds}): a camera that was lost")
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    remark = ""
    last = np.array([0.0, 0.0, 0.0, 1.0])
    if np.abs(matrix[3] - last).max() > EXACT_TOLERANCE:
        if np.abs(matrix[:, 3] - last).max() > EXACT_TOLERANCE:
            return Pose(None, f"its last row is {_shown(matrix[3])}, not 0 0 0 1")
        matrix, remark = matrix.T, "it is stored column by column and was transposed"
    if np.abs(matrix[:3, 3]).max() > MAX_POSITION_M:
        return Pose(None, f"its position is {_shown(matrix[:3, 3])}")
    rotation, problem = _rotation(matrix[:3, :3])
    if rotation is None:
        return Pose(None, problem)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, matrix[:3, 3]
    return Pose(pose, "; ".join(filter(None, (remark, problem))))


def _rotation(matrix: np.ndarray) -> tuple[np.ndarray | None, str]:
    """The rotation nearest to `matrix` (3, 3), or None; and the correction or the reason."""
    if np.abs(matrix).max() > MAX_POSITION_M:
        return None, f"its rotation has numbers up to {np.abs(matrix).max():.2g}"
    determinant = float(np.linalg.det(matrix))
    if determinant <= 0:
        what = "is a mirror image (determinant below 0)" if determinant < 0 else "has the determinant 0"
        return None, f"its rotation {what}"
    scale = determinant ** (1 / 3)
    error = float(np.abs(matrix.T @ matrix / scale**2 - np.eye(3)).max())
    if error > ORTHONORMAL_TOLERANCE:
        return None, f"its rotation is not orthonormal: R^T R is off by {error:.2g}, at most {ORTHONORMAL_TOLERANCE:g}"
    if not 1 / MAX_SCALE <= scale <= MAX_SCALE:
        return None, f"its rotation has a scale of {scale:.4g}; divide it by that, and bring translations to metres"
    u, _, vt = np.linalg.svd(matrix)
    if abs(scale - 1) > max(EXACT_TOLERANCE, error):
        return u @ vt, f"its rotation had a scale of {scale:.4g}, which was removed; translations are kept"
    if error > EXACT_TOLERANCE:
        return u @ vt, f"its rotation was made orthonormal: R^T R was off by {error:.2g}"
    return u @ vt, ""


def _shown(values: Iterable[float]) -> str:
    return " ".join(f"{value:g}" for value in values)


def pose_from_vectors(translation: np.ndarray, quaternion: np.ndarray) -> Pose:
    """From a translation (3,) and a quaternion x, y, z, w (4,), which is normalised."""
    if not (np.isfinite(translation).all() and np.isfinite(quaternion).all()):
        return Pose(None, "its numbers are not finite: a camera that was lost")
    if np.abs([*translation, *quaternion]).max() > MAX_POSITION_M:
        return Pose(None, f"its numbers are too large: {_shown([*translation, *quaternion])}")
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > NORM_TOLERANCE:
        return Pose(None, f"its quaternion {_shown(quaternion)} has the length {norm:.3g}, not 1")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), translation
    return Pose(pose)
