import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.recon.core.pose import pose_from_vectors, usable_pose

ROTATION = Rotation.from_euler("xyz", [20, 35, 8], degrees=True).as_matrix()
POSE = np.eye(4)
POSE[:3, :3], POSE[:3, 3] = ROTATION, [0.5, -2.0, 3.0]


def scaled(factor: float) -> np.ndarray:
    matrix = POSE.copy()
    matrix[:3, :3] *= factor
    return matrix


@pytest.mark.parametrize(
    ("matrix", "remark"),
    [
        (POSE, ""),
        (POSE[:3], ""),
        (scaled(1.02), "a scale of 1.02"),
        (scaled(0.95), "a scale of 0.95"),
        (POSE.T, "column by column"),
        (POSE.round(4), ""),
    ],
)
def test_poses_that_mean_one_thing_are_read(matrix, remark):
    pose = usable_pose(matrix)
    np.testing.assert_allclose(pose.T_world_camera, POSE, atol=1e-4)
    np.testing.assert_allclose(pose.T_world_camera[:3, :3] @ pose.T_world_camera[:3, :3].T, np.eye(3), atol=1e-12)
    assert remark in pose.remark
    assert bool(pose.remark) == bool(remark)


def test_a_rounded_rotation_is_made_orthonormal_and_named():
    pose = usable_pose(POSE.round(2))
    np.testing.assert_allclose(pose.T_world_camera, POSE, atol=6e-3)
    assert "made orthonormal" in pose.remark


@pytest.mark.parametrize(
    ("matrix", "reason"),
    [
        (POSE * np.nan, "not finite (nan)"),
        (POSE + 1e12 * np.eye(4, k=3), "its position is 1e+12"),
        (np.full((4, 4), -np.inf), "not finite (infinite)"),
        (POSE @ np.diag([1, 1, -1, 1]), "mirror image"),
        (scaled(1000), "a scale of 1000"),
        (POSE @ np.diag([1.1, 1, 1, 1]), "not orthonormal"),
        (np.zeros((4, 4)) + np.diag([0, 0, 0, 1]), "determinant 0"),
        (POSE + np.eye(4, k=-3), "last row is 1 0 0 1"),
    ],
)
def test_what_is_no_pose_has_its_reason(matrix, reason):
    pose = usable_pose(matrix)
    assert pose.T_world_camera is None
    assert reason in pose.remark


def test_quaternions_have_the_length_1():
    quaternion = Rotation.from_matrix(ROTATION).as_quat()
    np.testing.assert_allclose(pose_from_vectors(POSE[:3, 3], quaternion).T_world_camera, POSE, atol=1e-12)
    assert "has the length 2, not 1" in pose_from_vectors(POSE[:3, 3], 2 * quaternion).remark
    assert "not finite" in pose_from_vectors(POSE[:3, 3] * np.nan, quaternion).remark
