"""Rendering weights and rendered values against analysis and finite differences."""

import pytest
import torch
from uncle.recon.volume.rendering import render_depth, render_values, sdf_weights

SHARPNESS = 0.014


@pytest.fixture
def z() -> torch.Tensor:
    return torch.linspace(0.85, 1.15, 121, dtype=torch.float64).expand(3, 121)


def all_known(z: torch.Tensor) -> torch.Tensor:
    return torch.ones_like(z, dtype=torch.bool)


def test_weights_sum_to_one_and_are_a_bell_at_the_crossing(z):
    surface = torch.tensor([[0.99], [1.0], [1.01]], dtype=torch.float64)
    weights = sdf_weights(surface - z, all_known(z), SHARPNESS)
    torch.testing.assert_close(weights.sum(1), torch.ones(3, dtype=torch.float64))
    assert (weights >= 0).all()
    peak = z[0, weights.argmax(1)]
    assert (peak - surface[:, 0]).abs().max() < 0.0026
    torch.testing.assert_close(weights[1], weights[1].flip(0))  # symmetric about the surface in the middle
    expected = 0.25 / torch.cosh((surface - z) / SHARPNESS / 2).square()  # sigmoid(x) sigmoid(-x)
    torch.testing.assert_close(weights, expected / expected.sum(1, keepdim=True))


def test_depth_of_a_plane_is_its_distance(z):
    for distance in (0.99, 1.0, 1.012):
        window = z - 1.0 + distance  # samples surround the surface
        depth, variance = render_depth(sdf_weights(distance - window, all_known(z), SHARPNESS), window)
        assert (depth - distance).abs().max() < 1e-4
        logistic = (SHARPNESS * torch.pi) ** 2 / 3  # variance of the bell
        assert float(variance[0]) == pytest.approx(logistic, rel=0.05)
    slanted = 0.6 * (1.003 - z)  # a surface seen at 53 degrees
    depth, _ = render_depth(sdf_weights(slanted, all_known(z), SHARPNESS), z)
    assert (depth - 1.003).abs().max() < 1e-3


def test_second_surface_gets_nothing():
    z = torch.linspace(0.0, 0.6, 61).expand(1, 61)
    two_walls = torch.where(z < 0.25, 0.1 - z, (z - 0.2).where(z < 0.35, 0.5 - z))
    weights = sdf_weights(two_walls, all_known(z), SHARPNESS)
    assert weights[0, 45:].max() == 0
    assert weights[0, :25].sum() > 0.99
    assert float(render_depth(weights, z)[0]) == pytest.approx(0.1, abs=1e-3)


def test_unknown_samples_weigh_nothing(z):
    known = all_known(z).clone()
    known[0, :] = False
    known[1, 10:] = False
    weights = sdf_weights(1.0 - z, known, SHARPNESS)
    assert (weights[~known] == 0).all()
    assert weights[0].sum() == 0
    assert weights[1].sum() == pytest.approx(1.0)


def test_values_are_mixed_by_the_weights():
    weights = torch.tensor([[0.25, 0.75], [1.0, 0.0]])
    values = torch.tensor([[[1.0, 0.0], [0.0, 4.0]], [[2.0, 3.0], [9.0, 9.0]]])
    torch.testing.assert_close(render_values(weights, values), torch.tensor([[0.25, 3.0], [2.0, 3.0]]))
    depth, variance = render_depth(weights, torch.tensor([[1.0, 3.0], [5.0, 7.0]]))
    torch.testing.assert_close(depth, torch.tensor([2.5, 5.0]))
    torch.testing.assert_close(variance, torch.tensor([0.75, 0.0]))


def test_gradients_by_finite_differences():
    generator = torch.Generator().manual_seed(0)
    z = torch.linspace(0.9, 1.1, 9, dtype=torch.float64).expand(4, 9)
    noise = 0.002 * torch.rand(4, 9, dtype=torch.float64, generator=generator)
    sdf = (1.003 - z + noise).requires_grad_()
    values = torch.rand(4, 9, 3, dtype=torch.float64, generator=generator, requires_grad=True)

    def rendered(sdf, values):
        weights = sdf_weights(sdf, all_known(z), 0.05)
        return *render_depth(weights, z), render_values(weights, values)

    assert torch.autograd.gradcheck(rendered, (sdf, values), eps=1e-7)


def test_depth_follows_the_distance():
    """A field that says 1 mm more renders 1 mm deeper: the gradient that refinement lives on."""
    z = torch.linspace(0.85, 1.15, 121, dtype=torch.float64).expand(1, 121)
    sdf = (1.0 - z).clone().requires_grad_()
    render_depth(sdf_weights(sdf, all_known(z), SHARPNESS), z)[0].sum().backward()
    assert float(sdf.grad.sum()) == pytest.approx(1.0, abs=0.02)
