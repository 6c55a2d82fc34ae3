"""Feature grids: lookup against the trilinear formula, the optimiser against PyTorch's."""

import pytest
import torch
from uncle.recon.methods.pretrain.grids import EXTENT_M, FeatureGrids, interpolate


def test_lookup_reproduces_a_trilinear_function_in_world_axes():
    side = torch.linspace(-EXTENT_M / 2, EXTENT_M / 2, 5)
    z, y, x = torch.meshgrid(side, side, side, indexing="ij")
    grid = (1 + 2 * x - 3 * y + 5 * z)[None, None]
    points = (torch.rand(1, 30, 3) - 0.5) * EXTENT_M
    expected = 1 + points @ torch.tensor([2.0, -3.0, 5.0])
    torch.testing.assert_close(interpolate(grid, points)[..., 0], expected, atol=1e-5, rtol=0)


def test_steps_are_those_of_adam_for_every_age():
    grids = FeatureGrids(2, torch.Generator().manual_seed(0))
    start = grids.values["middle"].clone()
    reference = [start[:1].clone().requires_grad_(), start[1:].clone().requires_grad_()]
    optimizers = [torch.optim.Adam([value], lr=rate) for value, rate in zip(reference, (0.1, 0.3), strict=True)]
    for step in range(4):
        gradient = torch.randn(start.shape, generator=torch.Generator().manual_seed(step))
        grids.step({"middle": gradient}, {"middle": torch.tensor([0.1, 0.3])})
        for index, optimizer in enumerate(optimizers):
            reference[index].grad = gradient[index : index + 1]
            optimizer.step()
    torch.testing.assert_close(grids.values["middle"], torch.cat(reference).detach(), atol=1e-5, rtol=1e-4)


def test_renewed_cubes_start_near_zero_and_the_others_stay():
    grids = FeatureGrids(3, torch.Generator().manual_seed(0))
    for values in grids.values.values():
        values += 1.0
    grids.age += 7
    grids.renew(slice(1, 2))
    assert grids.age.tolist() == [7, 0, 7]
    assert grids.values["middle"][1].std().item() == pytest.approx(1e-2, rel=0.1)
    assert grids.values["fine"][1].std().item() == pytest.approx(1e-4, rel=0.1)
    assert grids.values["fine"][[0, 2]].mean().item() == pytest.approx(1.0, rel=0.01)
