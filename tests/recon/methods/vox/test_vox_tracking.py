"""Poses: the exponential, the gradient, and finding a camera."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from uncle.recon.methods.vox import tracking
from uncle.recon.methods.vox.pose import moved, rotation
from uncle.recon.methods.vox.tracking import pose_loss


@pytest.mark.parametrize("vector", [[0.3, -1.2, 0.4], [1e-6, 2e-6, 0.0], [0.0, 0.0, 0.0], [0.0, 3.1, 0.0]])
def test_rotation_is_that_of_scipy(vector):
    found = rotation(torch.tensor(vector, dtype=torch.float64))
    np.testing.assert_allclose(found.numpy(), Rotation.from_rotvec(vector).as_matrix(), atol=1e-9)


def test_the_motion_has_a_gradient_at_zero():
    motion = torch.zeros(6, requires_grad=True)
    turn, centre = moved(torch.eye(4), motion)
    (turn @ torch.tensor([0.0, 0.0, 1.0]) + centre)[0].backward()
    assert motion.grad.tolist() == [1, 0, 0, 0, 1, 0]  # x of a point ahead: moves along x, turns about y


@pytest.mark.parametrize("at", [0.0, 0.02])
def test_the_gradient_of_the_pose_is_that_of_finite_differences(wall, monkeypatch, at):
    monkeypatch.setattr(tracking, "sample_rays", lambda *_: wall.samples)
    pose = torch.eye(4, dtype=torch.float64)
    pose[:3, :3] = torch.from_numpy(Rotation.from_rotvec([0.2, 0.4, -0.3]).as_matrix())
    rays = wall.directions @ pose[:3, :3]  # in the camera
    start = torch.tensor([at, -at, at / 2, at, 0.0, -at], dtype=torch.float64)
    settings = wall.model.config.model_copy(update={"outlier_medians": 1e6})

    def loss(motion):
        return pose_loss(wall.model, pose, motion, rays, wall.targets, rays[:, 0], settings)[0]

    motion = start.clone().requires_grad_()
    found = torch.autograd.grad(loss(motion), motion)[0]
    steps = torch.eye(6, dtype=torch.float64) * 1e-6
    expected = torch.stack([(loss(start + step) - loss(start - step)).detach() / 2e-6 for step in steps])
    assert expected.abs().min() > 1e-3
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-5)
