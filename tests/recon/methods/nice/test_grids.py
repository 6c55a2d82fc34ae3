"""Dense feature grids: lookups and their gradients against grid_sample, growth."""

import pytest
import torch
from torch.nn.functional import grid_sample
from uncle.recon.core.errors import DataError
from uncle.recon.methods.nice.grids import FeatureGrid
from uncle.recon.methods.nice.scene import enlarged

CPU = torch.device("cpu")
BOUND = torch.tensor([[-1.0, 0.5, 2.0], [1.3, 2.1, 5.2]])


def make_grid(voxel: float = 0.4, seed: int = 0) -> FeatureGrid:
    return FeatureGrid.over(BOUND, voxel, 1.0, torch.Generator().manual_seed(seed), CPU)


def sampled(grid: FeatureGrid, points: torch.Tensor) -> torch.Tensor:
    """The oracle: x and z swapped as grid_sample wants them, coordinates mapped to -1 .. 1 over the box."""
    volume = grid.table.view(1, *grid.shape, -1).permute(0, 4, 3, 2, 1)
    places = 2 * (points - BOUND[0]) / (BOUND[1] - BOUND[0]) - 1
    return grid_sample(volume, places[None, None, None], padding_mode="border", align_corners=True)[0, :, 0, 0].T


def test_vertices_lie_on_the_box_at_about_the_voxel():
    grid = make_grid()
    assert grid.shape == (6, 4, 8)  # 2.3 / 0.4, 1.6 / 0.4, 3.2 / 0.4
    vertices = grid.vertices().view(*grid.shape, 3)
    torch.testing.assert_close(vertices[0, 0, 0], BOUND[0])
    torch.testing.assert_close(vertices[-1, -1, -1], BOUND[1])
    torch.testing.assert_close(grid.pitch, torch.tensor([2.3 / 5, 1.6 / 3, 3.2 / 7]))
    torch.testing.assert_close(grid.lookup(vertices.view(-1, 3)), grid.table)


def test_office_0_has_the_published_size():
    bound = enlarged(torch.tensor([[-5.5, -6.7, -4.7], [5.9, 5.4, 5.3]]))
    generator = torch.Generator()
    assert FeatureGrid.over(bound, 0.32, 0.01, generator, CPU).shape == (36, 38, 32)
    assert FeatureGrid.over(bound, 0.16, 0.01, generator, CPU).shape == (72, 76, 64)


def test_a_box_of_whole_steps_gets_one_more():
    torch.testing.assert_close(
        enlarged(torch.tensor([[0.0] * 3, [0.64, 0.65, 0.1]]))[1], torch.tensor([0.96, 0.96, 0.32])
    )


def test_lookup_and_its_gradients_are_those_of_grid_sample():
    grid = make_grid()
    grid.table = grid.table.double().requires_grad_()
    grid.low, grid.pitch = BOUND[0].double(), (BOUND[1] - BOUND[0]).double() / (torch.tensor(grid.shape) - 1)
    points = torch.rand(200, 3, dtype=torch.float64) * 4 - torch.tensor([1.5, 0.0, -1.5])  # some beyond the box
    weights = torch.randn(200, 32, dtype=torch.float64)
    results = []
    for read in (grid.lookup, lambda p: sampled(grid, p)):
        p = points.clone().requires_grad_()
        found = read(p)
        results.append((found, *torch.autograd.grad((found * weights).sum(), (grid.table, p))))
    for ours, theirs in zip(*results, strict=True):
        torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=1e-5)


def test_a_grown_grid_reads_the_same_where_it_was():
    grid, generator = make_grid(), torch.Generator().manual_seed(1)
    larger = grid.grown(torch.tensor([[-2.0, 0.5, 2.0], [1.3, 2.4, 5.2]]), generator)
    assert larger.shape == (grid.shape[0] + 3, grid.shape[1] + 1, grid.shape[2])
    points = BOUND[0] + torch.rand(100, 3) * (BOUND[1] - BOUND[0])
    torch.testing.assert_close(larger.lookup(points), grid.lookup(points))
    assert larger.table.std().item() == pytest.approx(1.0, abs=0.05)


def test_state_and_back():
    grid = make_grid()
    again = FeatureGrid.from_state(grid.to_state(), CPU)
    points = torch.rand(10, 3)
    assert torch.equal(again.lookup(points), grid.lookup(points))


def test_a_box_too_large_for_a_dense_grid_is_refused_with_its_size():
    bound = torch.tensor([[0.0, 0.0, 0.0], [1000.0, 300.0, 100.0]])
    with pytest.raises(DataError, match=r"1000 x 300 x 100 m.*nice\.bound"):
        FeatureGrid.over(bound, 0.16, 1.0, torch.Generator(), CPU)
    with pytest.raises(DataError, match=r"nice\.bound"):
        make_grid().grown(bound, torch.Generator())
