"""h_w as specified: counts, start value, patches, and what a pixel of them is."""

import math

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.methods.nice.noise import NoiseNet, gather_patches, noise_inputs


@pytest.mark.parametrize(("inputs", "parameters"), [(2, 5889), (7, 9889), (3, 6689)])
def test_parameter_counts(inputs, parameters):
    assert sum(p.numel() for p in NoiseNet(inputs).parameters()) == parameters


def test_the_papers_count_is_that_of_a_single_pixel_and_one_layer_more():
    """The paper's 5409 is a patch of 1 x 1, two features and six hidden layers of 32; five have 1056 fewer."""
    single = sum(p.numel() for p in NoiseNet(2, patch=1).parameters())
    assert single == 4353 == 5409 - (32 * 32 + 32)


def test_a_fresh_net_says_log_2_where_it_sees_nothing():
    torch.testing.assert_close(NoiseNet(2)(torch.zeros(3, 50)), torch.full((3,), math.log(2)))


def test_patches_are_those_of_shifted_images():
    """The oracle: the whole image rolled 25 times, as the published code does it."""
    images = torch.arange(2 * 3 * 2 * 6 * 7, dtype=torch.float32).view(2, 3, 2, 6, 7)
    frames, rows, columns = torch.tensor([0, 1, 1]), torch.tensor([0, 3, 5]), torch.tensor([6, 2, 0])
    shifts = [(y, x) for y in range(-2, 3) for x in range(-2, 3)]
    rolled = torch.stack([images.roll((-y, -x), (-2, -1)) for y, x in shifts], 3)  # (2, 3, 2, 25, 6, 7)
    expected = rolled[frames, :, :, :, rows, columns].flatten(2)
    torch.testing.assert_close(gather_patches(images, frames, rows, columns), expected)


def test_a_frontal_wall_is_seen_at_angle_zero():
    camera = Camera(9, 9, 20.0, 20.0, 4.0, 4.0)
    depth, normals = torch.full((9, 9), 2.0), torch.zeros(9, 9, 3)
    normals[..., 2] = -1.0
    normals[0, 0] = 0.0
    images = noise_inputs(depth, normals, camera, 2, released=False)
    assert images.shape == (2, 9, 9)
    assert images[1, 4, 4] == 0.0
    assert images[1, 4, 8] == pytest.approx(math.atan(4 / 20), abs=1e-3)
    assert images[1, 0, 0] == pytest.approx(math.pi / 2)  # unknown


def test_the_published_code_has_the_cosine_of_its_own_normals():
    camera = Camera(12, 12, 20.0, 20.0, 5.5, 5.5)
    images = noise_inputs(torch.full((12, 12), 2.0), torch.zeros(12, 12, 3), camera, 7, released=True)
    assert images.shape == (7, 12, 12)
    np.testing.assert_allclose(images[3, 4:8, 4:8], 1.0, atol=1e-3)  # normals point away from the camera
    np.testing.assert_allclose(images[4, 5, 5], 1.0, atol=1e-3)
    np.testing.assert_allclose(images[5:, 4:8, 4:8], 0.0, atol=1e-6)
