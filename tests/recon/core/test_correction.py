import numpy as np
import torch
from scipy.spatial.transform import Rotation
from uncle.recon.core.camera import Camera
from uncle.recon.core.correction import Correction, shifted_poses
from uncle.recon.core.se3 import inverse


def poses_of(count):
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(np.arange(count), [0.0, 0.1, 0.0])).as_matrix()
    poses[:, 0, 3] = np.arange(count)
    return poses


def test_a_lag_interpolates_position_and_rotation():
    moved = shifted_poses(poses_of(4), 0.5)
    np.testing.assert_allclose(moved[1, :3, 3], [1.5, 0, 0])
    np.testing.assert_allclose(Rotation.from_matrix(moved[1, :3, :3]).as_rotvec(), [0, 0.15, 0], atol=1e-12)
    assert np.isnan(moved[3]).all()  # beyond the end


def test_a_lag_does_not_invent_poses_beside_missing_ones():
    poses = poses_of(5)
    poses[2] = np.nan
    known = np.isfinite(shifted_poses(poses, 1.0)).all((1, 2))
    np.testing.assert_array_equal(known, [True, False, True, True, False])


def test_poses_are_inverted_scaled_and_turned():
    poses = poses_of(3)
    np.testing.assert_allclose(Correction(is_inverted=True).poses(inverse(poses)), poses, atol=1e-12)
    np.testing.assert_allclose(Correction(translation_factor=0.001).poses(poses)[2, 0, 3], 0.002)
    turned = Correction(is_opengl=True).poses(poses)
    np.testing.assert_allclose(turned[:, :3, 2], -poses[:, :3, 2])
    np.testing.assert_allclose(turned[:, :3, 3], poses[:, :3, 3])


def test_the_camera_is_corrected_and_only_changes_are_described():
    camera = Correction(focal_x=0.5, shift_x=-3.0).camera(Camera(64, 48, 60.0, 61.0, 31.5, 23.5))
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30.0, 61.0, 28.5, 23.5)
    assert Correction(focal_x=0.5, is_inverted=True).describe() == {"focal_x": 0.5, "is_inverted": True}


def test_colour_is_moved_without_wrapping():
    from uncle.recon.core.correction import CorrectedRecording

    class OneFrame:
        name, format, sensors, has_poses, has_timestamps = "one", "none", ("depth",), False, False
        reference_mesh, notes, registration_sigma_px = None, (), 0.0
        camera = Camera(4, 3, 5.0, 5.0, 1.5, 1.0)

        def __len__(self):
            return 1

        def pose(self, index):
            return None

        def color(self, index):
            return torch.arange(36, dtype=torch.uint8).reshape(3, 4, 3)

    moved = CorrectedRecording(OneFrame(), Correction(color_x=1, color_y=-1)).color(0)
    assert moved[2].sum() == 0
    assert moved[:, 0].sum() == 0
    torch.testing.assert_close(moved[0, 1:], OneFrame().color(0)[1, :3])
