"""Samples along rays, and what they render to: known answers."""

import pytest
import torch
from uncle.recon.methods.nice.rays import box_exit, ray_weights, render_depth, sample_depths


def test_where_rays_leave_a_box():
    bound = torch.tensor([[0.0, 0.0, 0.0], [4.0, 2.0, 1.0]])
    origins = torch.tensor([[1.0, 1.0, 0.5]]).repeat(3, 1)
    directions = torch.tensor([[1.0, 0.0, 0.0], [-1.0, 0.5, 0.0], [0.0, 0.0, 2.0]])
    torch.testing.assert_close(box_exit(origins, directions, bound), torch.tensor([3.0, 1.0, 0.25]))


def test_samples_of_two_sensors_are_sorted_and_where_they_belong():
    depths = torch.tensor([[2.0, 0.0], [1.0, 3.0]])
    z = sample_depths(depths, torch.tensor([10.0, 2.5]), uniform=32, near_surface=16)
    assert z.shape == (2, 64)
    assert (z.diff(dim=1) >= 0).all()
    first, second = z
    assert first[0] == pytest.approx(0.001)  # the sensor that reads nothing is sampled from there
    assert first[-1] == pytest.approx(1.2 * 3.0)
    assert ((first >= 1.9 - 1e-6) & (first <= 2.1 + 1e-6)).sum() >= 16
    assert second[0] == pytest.approx(0.01 * 2.0)  # the mean of its readings
    assert ((second >= 0.95 - 1e-6) & (second <= 1.05 + 1e-6)).sum() >= 16
    assert ((second > 2.51 + 1e-6) & (second < 2.85 - 1e-6)).sum() == 0  # the uniform ones end at the box
    assert second[-1] == pytest.approx(3.15)


def test_a_batch_without_readings_is_sampled_up_to_the_box():
    z = sample_depths(torch.zeros(2, 1), torch.tensor([1.0, 3.0]), uniform=4, near_surface=2)
    torch.testing.assert_close(z.amax(1), torch.tensor([1.0, 3.0]))


def test_a_wall_is_rendered_where_it_stands():
    z = torch.linspace(0.1, 4.0, 40)[None]
    seen = render_depth(torch.where(z < 2.05, -5.0, 5.0), z)
    assert seen.depth.item() == pytest.approx(2.1, abs=1e-4)
    assert seen.variance.item() == pytest.approx(0.0, abs=1e-4)


def test_half_and_half():
    """Occupancy 1/2 at 1 m and 1 at 3 m: depth 2 m, variance 1."""
    seen = render_depth(torch.tensor([[-9.0, 0.0, -9.0, 9.0]]), torch.tensor([[0.5, 1.0, 2.0, 3.0]]))
    torch.testing.assert_close(seen.weights, torch.tensor([[0.0, 0.5, 0.0, 0.5]]), atol=1e-6, rtol=0)
    assert (seen.depth.item(), seen.variance.item()) == (pytest.approx(2.0), pytest.approx(1.0))


def test_empty_space_has_depth_zero():
    assert render_depth(torch.full((1, 8), -9.0), torch.ones(1, 8)).depth.item() == pytest.approx(0.0, abs=1e-6)
    assert ray_weights(torch.randn(5, 20)).sum(1).max() <= 1 + 1e-5
