"""Camera poses of recordings: axes and interpolation. The one place where axes are converted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from ..recon.core.pose import Pose
from ..recon.core.trajectory import Trajectory

MAX_POSE_GAP_S = 0.08  # poses are not interpolated across a wider gap: the camera can turn within it

# Negates the y and z axes of a camera: OpenGL (y up, z backward) <-> OpenCV (y down, z forward).
OPENGL_TO_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
# Rotates a world with y up by +90 degrees about x: (x, y, z) -> (x, -z, y), z up.
Z_UP_FROM_Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])


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
