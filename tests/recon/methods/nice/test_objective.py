"""The losses of the paper and of NICE-SLAM against sums written out by hand, and what the networks learn from them."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.nice import NiceConfig, NiceTrackingConfig
from uncle.recon.core.se3 import apply_motion, predict_pose
from uncle.recon.methods.nice.objective import RenderedRays, mapping_loss, tracking_loss
from uncle.recon.methods.nice.poses import to_pose_matrix, to_pose_vector, to_rigid
from uncle.recon.methods.nice.views import Rays
from uncle.recon.methods.nice.weighting import LaplaceWeighting, UniformWeighting

CAMERA = Camera(8, 6, 10.0, 10.0, 3.5, 2.5)
CPU = torch.device("cpu")


def make_rays(depths: torch.Tensor) -> Rays:
    count, sensors = depths.shape
    generator = torch.Generator().manual_seed(1)
    colors = torch.rand(count, 3, generator=generator)
    weighting_inputs, patches = (
        torch.rand(count, sensors, 50, generator=generator),
        torch.rand(count, 75, generator=generator),
    )
    views = torch.zeros(count, dtype=torch.long)
    return Rays(views, torch.zeros(count, 3), depths, colors, lambda: weighting_inputs, lambda: patches)


DEPTHS = torch.tensor([[2.0, 2.5], [1.0, 0.0], [3.0, 3.0], [0.0, 1.5]])
RAYS = make_rays(DEPTHS)
RENDERED = RenderedRays(torch.tensor([2.1, 1.2, 2.0, 1.0]), torch.tensor([0.1, 0.2, 0.3, 0.0]), torch.full((4, 3), 0.5),
                  torch.tensor([True, True, False, True]))  # fmt: skip


def laplace(**settings) -> LaplaceWeighting:
    return LaplaceWeighting(NiceConfig(**settings), ("a", "b"), CAMERA, torch.Generator().manual_seed(0), CPU)


def uniform(**settings) -> UniformWeighting:
    return UniformWeighting(NiceConfig(**settings), NiceTrackingConfig())


def color_errors() -> np.ndarray:
    return (RAYS.colors - 0.5).abs().sum(1).numpy()


def test_unit_weights_sum_what_is_read_inside_the_box():
    depth = 0.1 + 0.4 + 0.2 + 0.5  # the third ray leaves the box before its reading
    assert mapping_loss(replace(RENDERED, colors=None), RAYS, uniform(), "middle").item() == pytest.approx(depth)
    color = 0.2 * color_errors()[[0, 1, 3]].sum()
    assert mapping_loss(RENDERED, RAYS, uniform(), "color").item() == pytest.approx(depth + color)


@pytest.mark.parametrize("reproduce_released_code", [False, True])
def test_laplace_loss(reproduce_released_code):
    weighting = laplace(reproduce_released_code=reproduce_released_code)
    beta = np.stack(
        [1e-3 + net(RAYS.weighting_inputs[:, k]).detach().numpy() for k, net in enumerate(weighting.depth_networks)], 1
    )
    residuals = np.abs(DEPTHS.numpy() - RENDERED.depth.numpy()[:, None])
    used = [(0, 0), (0, 1), (1, 0), (3, 1)]
    depth = sum(residuals[i] / beta[i] + math.log(beta[i]) for i in used)
    color_beta = 1e-3 + weighting.color_network(RAYS.color_patches).detach().numpy()
    inside = [0, 1, 3]
    color = (color_errors() / color_beta + np.log(color_beta))[inside].sum()
    black = (RAYS.colors.sum(1).numpy() / color_beta + np.log(color_beta))[inside].sum()
    plain = replace(RENDERED, colors=None)
    assert mapping_loss(plain, RAYS, weighting, "middle").item() == pytest.approx(sum(residuals[i] for i in used))
    fine = depth + (black if reproduce_released_code else 0.0)
    assert mapping_loss(plain, RAYS, weighting, "fine").item() == pytest.approx(fine, rel=1e-5)
    assert mapping_loss(RENDERED, RAYS, weighting, "color").item() == pytest.approx(depth + color, rel=1e-5)
    assert list(weighting.mean_nll()) == ["a", "b"]


def test_tracking_loss_of_the_paper_and_of_the_published_code():
    """D1 to D3: the sum of the sensors' means with beta_min in the scale, or the last sensor's sum without it."""
    residuals = np.abs(DEPTHS.numpy() - RENDERED.depth.numpy()[:, None])
    spread = RENDERED.spread.numpy()
    for reproduce_released_code in (False, True):
        weighting = laplace(reproduce_released_code=reproduce_released_code)
        raw = np.stack(
            [net(RAYS.weighting_inputs[:, k]).detach().numpy() for k, net in enumerate(weighting.depth_networks)], 1
        )
        color = color_errors() / (1e-3 + weighting.color_network(RAYS.color_patches).detach().numpy())
        scaled = residuals / (spread[:, None] + raw + (0 if reproduce_released_code else 1e-3))
        if reproduce_released_code:
            expected = scaled[[0, 3], 1].sum() + color[[0, 3]].sum()
        else:
            expected = scaled[[0, 1], 0].mean() + scaled[[0, 3], 1].mean() + color[[0, 1, 3]].mean()
        assert tracking_loss(RENDERED, RAYS, weighting, reproduce_released_code).item() == pytest.approx(
            expected, rel=1e-4
        )


def test_outliers_and_holes_do_not_pull_the_camera():
    depths = torch.ones(21, 1)
    depths[20] = 9.0
    rays = make_rays(depths)
    rendered = RenderedRays(torch.full((21,), 1.1), torch.full((21,), 0.1), None, torch.ones(21, dtype=torch.bool))
    assert tracking_loss(rendered, rays, uniform(), False).item() == pytest.approx(1.0, rel=1e-4)
    assert torch.isnan(tracking_loss(rendered, make_rays(torch.zeros(21, 1)), uniform(), False))


def test_h_w_learns_which_sensor_is_noisy():
    """Residuals of 0.02 m and 0.3 m: beta comes to lie there, with the paper's own step size."""
    weighting, generator = laplace(), torch.Generator().manual_seed(0)
    true = torch.tensor([0.02, 0.3])
    adam = torch.optim.Adam([p for net in weighting.networks().values() for p in net.parameters()], 3e-4 * 5)
    rays = make_rays(torch.full((400, 2), 2.0))
    valid = torch.ones(400, 2, dtype=torch.bool)
    for _ in range(300):
        residuals = -true * torch.log(torch.rand(400, 2, generator=generator))
        loss = weighting.depth_loss(residuals, valid, rays, "fine")
        adam.zero_grad()
        loss.backward()
        adam.step()
    beta = 1e-3 + torch.stack(
        [net(rays.weighting_inputs[:, k]).mean() for k, net in enumerate(weighting.depth_networks)]
    )
    torch.testing.assert_close(beta, true, rtol=0.15, atol=0.0)
    expected = (1 + torch.log(2 * true)).tolist()
    assert list(weighting.mean_nll().values()) == pytest.approx(expected, abs=0.1)


def test_beta_images_are_those_of_the_patches():
    weighting = laplace()
    weighting_inputs = torch.rand(2, 2, 6, 8) + 0.1
    weighting_inputs[1, 0, 2, 3] = 0.0
    images = weighting.betas(None, weighting_inputs)
    patch = weighting_inputs[0].roll((1, -2), (1, 2))[:, :5, :5].reshape(1, 50)  # around row 1, column 4
    expected = 1e-3 + weighting.depth_networks[0](patch)
    assert images["a"][1, 4].item() == pytest.approx(expected.item(), rel=1e-5)
    assert images["b"][2, 3] == 0.0


def test_with_a_patch_of_one_pixel_beta_is_that_of_the_pixel():
    weighting = laplace(noise_patch=1)
    assert weighting.patch_size == 1
    weighting_inputs = torch.rand(2, 2, 6, 8) + 0.1
    expected = 1e-3 + weighting.depth_networks[1](weighting_inputs[1, :, 4, 7][None])
    assert weighting.betas(None, weighting_inputs)["b"][4, 7].item() == pytest.approx(expected.item(), rel=1e-5)


def test_poses_and_their_prediction():
    first = apply_motion(np.eye(4), np.array([0.1, 0.2, -0.3, 0.3, -0.2, 0.1]))
    step = apply_motion(np.eye(4), np.array([0.01, 0.0, 0.02, 0.0, 0.05, 0.0]))
    longer = to_pose_vector(first) * torch.tensor([3.0] * 4 + [1.0] * 3)
    np.testing.assert_allclose(to_rigid(to_pose_matrix(longer[None])[0]), first, atol=1e-6)
    np.testing.assert_allclose(predict_pose([first, step @ first]), step @ step @ first, atol=1e-12)
    np.testing.assert_allclose(predict_pose([first]), first)
