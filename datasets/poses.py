"""Camera poses of recordings: checking matrices and interpolating. The one place where axes are converted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from ..recon.core.trajectory import Trajectory

MAX_POSE_GAP_S = 0.08  # poses are not interpolated across a wider gap: the camera can turn within it
ORTHONORMAL_TOLERANCE = 2e-2  # two decimals, rounded; anything beyond is no rotation
NORM_TOLERANCE = 0.05  # of quaternions in text
EXACT_TOLERANCE = 1e-3  # a rotation that is off by more is corrected with a remark
MAX_SCALE = 1.1  # of a rotation, or its inverse; more is another unit of length, not an alignment that fitted a scale

# Negates the y and z axes of a camera: OpenGL (y up, z backward) <-> OpenCV (y down, z forward).
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
# Rotates a world with y up by +90 degrees about x: (x, y, z) -> (x, -z, y), z up.
Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


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
    rotation, problem = _rotation(matrix[:3, :3])
    if rotation is None:
        return Pose(None, problem)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, matrix[:3, 3]
    return Pose(pose, "; ".join(filter(None, (remark, problem))))


def _rotation(matrix: np.ndarray) -> tuple[np.ndarray | None, str]:
    """The rotation nearest to `matrix` (3, 3), or None; and the correction or the reason."""
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
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1) > NORM_TOLERANCE:
        return Pose(None, f"its quaternion {_shown(quaternion)} has the length {norm:.3g}, not 1")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.from_quat(quaternion).as_matrix(), translation
    return Pose(pose)


def interpolate_poses(trajectory: Trajectory, timestamps: np.ndarray, max_gap_s: float = MAX_POSE_GAP_S) -> list[Pose]:
    """Poses at `timestamps` (N,), slerp and linear between the two known stamps around each.

    None outside the trajectory, beside an unusable pose, and where the two stamps lie more than `max_gap_s` apart.
    """
    known = trajectory.finite()
    return [_pose_at(known.timestamps, known.T_world_camera, stamp, max_gap_s) for stamp in timestamps]


def _pose_at(times: np.ndarray, matrices: np.ndarray, stamp: float, max_gap_s: float) -> Pose:
    exact = np.flatnonzero(np.abs(times - stamp) < 1e-6)
    if exact.size:
        return Pose(matrices[exact[0]])
    after = int(np.searchsorted(times, stamp))
    if after in (0, len(times)):
        side = "before the first" if after == 0 else "after the last"
        return Pose(None, f"its time {stamp:.3f} is {side} usable pose")
    gap = times[after] - times[after - 1]
    if gap > max_gap_s:
        return Pose(None, f"the poses around its time {stamp:.3f} are {gap:.3f} s apart, more than {max_gap_s:g} s")
    weight = (stamp - times[after - 1]) / gap
    first, second = matrices[after - 1], matrices[after]
    start = Rotation.from_matrix(first[:3, :3])
    turn = start.inv() * Rotation.from_matrix(second[:3, :3])
    pose = np.eye(4)
    pose[:3, :3] = (start * Rotation.from_rotvec(weight * turn.as_rotvec())).as_matrix()
    pose[:3, 3] = (1 - weight) * first[:3, 3] + weight * second[:3, 3]
    return Pose(pose)


def pose_notes(poses: Sequence[Pose]) -> tuple[str, ...]:
    """A line about frames without a usable pose, and one about corrected poses: how many, the first, and why."""
    notes = []
    missing = [index for index, pose in enumerate(poses) if pose.T_world_camera is None]
    reasons = [index for index in missing if poses[index].remark]
    if reasons or 0 < len(missing) < len(poses):
        first = (reasons or missing)[0]
        why = f": {poses[first].remark}" if poses[first].remark else ""
        notes.append(f"{len(missing)} of {len(poses)} frames have no usable pose (the first: frame {first}{why})")
    corrected = [index for index, pose in enumerate(poses) if pose.T_world_camera is not None and pose.remark]
    if corrected:
        first = corrected[0]
        notes.append(f"{len(corrected)} of {len(poses)} poses were corrected (frame {first}: {poses[first].remark})")
    return tuple(notes)
