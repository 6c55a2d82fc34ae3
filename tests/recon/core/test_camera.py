"""The pinhole camera: what holds between its projections, and cameras of changed images."""

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera, project_into

CAMERA = Camera(64, 48, 50.0, 55.0, 30.0, 22.5)
RNG = np.random.default_rng(0)
POINTS = RNG.uniform((-1, -1, 0.5), (1, 1, 3), (20, 3))


def test_arrays_and_tensors_project_alike():
    u, v, z = CAMERA.project_array(POINTS)
    for array, tensor in zip((u, v, z), CAMERA.project(torch.from_numpy(POINTS)), strict=True):
        np.testing.assert_array_equal(array, tensor.numpy())
    pixels, _ = CAMERA.project_with_derivatives(POINTS, 0.05)
    np.testing.assert_allclose(pixels, np.stack([u, v], 1), rtol=1e-12)


def test_unproject_is_the_inverse_of_the_projection():
    u, v, z = CAMERA.project_array(POINTS)
    x, y = CAMERA.unproject(u, v)
    np.testing.assert_allclose(np.stack([x * z, y * z, z], 1), POINTS, atol=1e-12)
    rays = CAMERA.rays()
    for value, channel in zip(CAMERA.unproject(torch.tensor(5.0), torch.tensor(7.0)), rays[7, 5], strict=False):
        assert value == channel


def test_a_projection_keeps_the_type():
    assert {values.dtype for values in CAMERA.project_array(POINTS.astype(np.float32))} == {np.dtype(np.float32)}


def test_derivatives_of_the_projection():
    _, derivative = CAMERA.project_with_derivatives(POINTS, 0.05)
    step = 1e-6
    for axis in range(3):
        ahead, behind = (CAMERA.project_with_derivatives(POINTS + s * np.eye(3)[axis], 0.05)[0] for s in (step, -step))
        np.testing.assert_allclose(derivative[..., axis], (ahead - behind) / (2 * step), rtol=1e-5, atol=1e-4)


def test_points_behind_the_camera_project_at_the_least_depth():
    pixels, _ = CAMERA.project_with_derivatives(np.array([[0.1, 0.0, -2.0]]), 0.5)
    assert pixels[0, 0] == pytest.approx(50.0 * 0.1 / 0.5 + 30.0)


@pytest.mark.parametrize("step", [1, 3, 5])
def test_the_strided_camera_has_every_nth_ray(step):
    strided = CAMERA.strided(step)
    expected = CAMERA.rays()[::step, ::step]
    assert (strided.height, strided.width) == expected.shape[:2]
    torch.testing.assert_close(strided.rays(), expected)


def test_project_into_keeps_what_is_in_front_and_inside():
    T = np.eye(4)
    T[:3, 3] = 1.0, 2.0, 3.0
    points = T[:3, 3] + np.array([[0.0, 0.0, 2.0], [0.0, 0.0, -2.0], [9.0, 0.0, 2.0], [0.02, 0.0, 1.0]])
    rows, pixels, z = project_into(points, CAMERA, T)
    assert rows.tolist() == [0, 3]
    assert pixels.tolist() == [[30, 22], [31, 22]]
    np.testing.assert_allclose(z, [2.0, 1.0])
