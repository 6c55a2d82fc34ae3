"""Camera poses of recordings: reading, checking, interpolating. The one place where axes are converted."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..recon.core.errors import DataError
from ..recon.core.trajectory import Trajectory

MAX_POSE_GAP_S = 0.08  # poses are not interpolated across a wider gap: the camera can turn within it
ORTHONORMAL_TOLERANCE = 1e-2  # text files round; anything beyond is no rotation

# Negates the y and z axes of a camera: OpenGL (y up, z backward) <-> OpenCV (y down, z forward).
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
# Rotates a world with y up by +90 degrees about x: (x, y, z) -> (x, -z, y), z up.
Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


def checked_pose(matrix: np.ndarray | None) -> np.ndarray | None:
    """(4, 4) float64 pose with an exact rotation; None if it is not finite or not a rigid motion."""
    if matrix is None or matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        return None
    rotation = matrix[:3, :3]
    if np.abs(rotation.T @ rotation - np.eye(3)).max() > ORTHONORMAL_TOLERANCE or np.linalg.det(rotation) < 0:
        return None
    if np.abs(matrix[3] - [0, 0, 0, 1]).max() > ORTHONORMAL_TOLERANCE:
        return None
    u, _, vt = np.linalg.svd(rotation)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = u @ vt, matrix[:3, 3]
    return pose


def read_matrix(path: Path | None) -> np.ndarray | None:
    """The (4, 4) matrix of a text file of 16 numbers; None if the file is missing or holds anything else."""
    try:
        return matrix_from_text(path.read_text()) if path is not None else None
    except (OSError, UnicodeDecodeError):
        return None


def matrix_from_text(text: str) -> np.ndarray | None:
    """(4, 4) from 16 numbers, row by row; None if it is not that."""
    try:
        values = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        return None
    return values.reshape(4, 4) if values.size == 16 else None


def interpolate_poses(
    trajectory: Trajectory, timestamps: np.ndarray, max_gap_s: float = MAX_POSE_GAP_S
) -> list[np.ndarray | None]:
    """Poses at `timestamps` (N,), slerp and linear between the two known stamps around each.

    None outside the trajectory, beside an unusable pose, and where the two stamps lie more than `max_gap_s` apart.
    """
    order = np.argsort(trajectory.timestamps, kind="stable")
    times, matrices = trajectory.timestamps[order], trajectory.T_world_camera[order]
    known = np.isfinite(times) & np.isfinite(matrices).all(axis=(1, 2))
    times, matrices = times[known], matrices[known]
    return [_pose_at(times, matrices, stamp, max_gap_s) for stamp in timestamps]


def _pose_at(times: np.ndarray, matrices: np.ndarray, stamp: float, max_gap_s: float) -> np.ndarray | None:
    exact = np.flatnonzero(np.abs(times - stamp) < 1e-6)
    if exact.size:
        return checked_pose(matrices[exact[0]])
    after = int(np.searchsorted(times, stamp))
    if after in (0, len(times)) or times[after] - times[after - 1] > max_gap_s:
        return None
    weight = (stamp - times[after - 1]) / (times[after] - times[after - 1])
    first, second = matrices[after - 1], matrices[after]
    start = Rotation.from_matrix(first[:3, :3])
    turn = start.inv() * Rotation.from_matrix(second[:3, :3])
    pose = np.eye(4)
    pose[:3, :3] = (start * Rotation.from_rotvec(weight * turn.as_rotvec())).as_matrix()
    pose[:3, 3] = (1 - weight) * first[:3, 3] + weight * second[:3, 3]
    return pose


def poses_at(file: Path, timestamps: np.ndarray, max_gap_s: float = MAX_POSE_GAP_S) -> list[np.ndarray | None]:
    """Poses of the TUM text `file` at `timestamps` (N,). Raises DataError if they have no moment in common."""
    trajectory = Trajectory.load(file)
    poses = interpolate_poses(trajectory, timestamps, max_gap_s)
    if all(pose is None for pose in poses):
        problem = no_overlap(str(file), trajectory.timestamps, "the images", timestamps)
        raise DataError(f"{problem}, or remove {file.name} to go on without poses")
    return poses


def no_overlap(first: str, first_times: np.ndarray, second: str, second_times: np.ndarray) -> str:
    """What to tell a user whose two streams have no time stamps in common."""
    return (
        f"{first}: its time stamps ({first_times.min():.3f} to {first_times.max():.3f}) do not meet those of "
        f"{second} ({second_times.min():.3f} to {second_times.max():.3f}); check that both are of one recording"
    )


def pose_notes(poses: Sequence[np.ndarray | None]) -> tuple[str, ...]:
    """A line about frames without a pose, if some have one and some have none."""
    missing = [index for index, pose in enumerate(poses) if pose is None]
    if not missing or len(missing) == len(poses):
        return ()
    return (f"{len(missing)} of {len(poses)} frames have no usable pose (the first: frame {missing[0]})",)
