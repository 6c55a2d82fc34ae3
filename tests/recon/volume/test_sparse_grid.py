"""The sparse grid against dense arithmetic."""

import numpy as np
import pytest
import torch
from uncle.recon.volume.sparse_grid import BLOCK, ROWS, SparseGrid, unique_blocks


def cube(low: int, high: int) -> torch.Tensor:
    """All block coordinates of low <= x, y, z < high."""
    return torch.cartesian_prod(*[torch.arange(low, high)] * 3)


@pytest.fixture
def grid() -> SparseGrid:
    made = SparseGrid(0.05)
    made.allocate(cube(-2, 2))
    return made


def test_rows_are_one_for_each_sample_and_lie_where_positions_say(grid):
    positions = grid.block_positions(torch.arange(len(grid.blocks))).view(-1, 3)
    samples = torch.round(positions / grid.voxel_size_m).long()
    assert samples.min() == -2 * BLOCK
    assert samples.max() == 2 * BLOCK - 1
    torch.testing.assert_close(grid.sample_rows(samples), torch.arange(grid.rows))
    torch.testing.assert_close(grid.nearest_rows(positions + 0.02), torch.arange(grid.rows))


def test_what_does_not_exist_is_minus_one(grid):
    absent = torch.tensor([[2, 0, 0], [0, -3, 0], [0, 0, 100000], [-100000, 0, 0]])
    assert (grid.block_ids(absent) == -1).all()
    assert (grid.sample_rows(absent * BLOCK) == -1).all()
    rows, _ = grid.trilinear(torch.tensor([[15.5 * 0.05, 0.01, 0.01]]))  # the last sample's upper neighbour is missing
    assert (rows >= 0).sum() == 4
    assert (SparseGrid(0.05).block_ids(absent) == -1).all()


def test_growth_keeps_rows_and_counts_only_what_is_new(grid):
    before = grid.blocks.clone()
    assert grid.allocate(cube(-1, 3)) == 4**3 - 3**3
    assert grid.allocate(cube(-40, -38)) == 8
    assert grid.allocate(cube(-40, -38)) == 0
    assert grid.allocate(torch.zeros(0, 3, dtype=torch.int64)) == 0
    torch.testing.assert_close(grid.blocks[: len(before)], before)
    torch.testing.assert_close(grid.block_ids(grid.blocks), torch.arange(len(grid.blocks)))
    assert grid.rows == len(grid.blocks) * ROWS


def test_restore_gives_the_same_rows(grid):
    grid.allocate(torch.tensor([[30, -7, 2], [-30, 1, 1]]))
    other = SparseGrid(0.05)
    other.allocate(cube(5, 7))
    other.restore(grid.blocks)
    samples = torch.randint(-300, 300, (5000, 3), generator=torch.Generator().manual_seed(0))
    samples[:100] = grid.blocks.repeat(2, 1)[:100] * BLOCK
    torch.testing.assert_close(other.sample_rows(samples), grid.sample_rows(samples))
    other.restore(grid.blocks[:0])
    assert other.rows == 0
    assert (other.sample_rows(samples) == -1).all()


def test_trilinear_reproduces_a_linear_function(grid):
    slope, offset = torch.tensor([1.5, -0.7, 0.3]), 0.2
    table = grid.block_positions(torch.arange(len(grid.blocks))).view(-1, 3) @ slope + offset
    points = torch.rand(2000, 3, generator=torch.Generator().manual_seed(1)) * 1.5 - 0.78
    rows, weights = grid.trilinear(points)
    assert (rows >= 0).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(2000))
    assert (weights >= 0).all()
    torch.testing.assert_close((table[rows] * weights).sum(1), points @ slope + offset, atol=2e-6, rtol=0)


def test_trilinear_reproduces_a_product(grid):
    positions = grid.block_positions(torch.arange(len(grid.blocks))).view(-1, 3)
    points = torch.rand(500, 3, generator=torch.Generator().manual_seed(2)) * 1.5 - 0.78
    rows, weights = grid.trilinear(points)
    corner = torch.floor(points / 0.05) * 0.05
    table = ((positions[rows] - corner[:, None]) / 0.05).prod(-1)  # x y z of each cell, 0 or 1 at its corners
    torch.testing.assert_close((table * weights).sum(1), ((points - corner) / 0.05).prod(-1), atol=1e-4, rtol=0)


def test_unique_blocks_agrees_with_numpy():
    blocks = torch.randint(-4, 4, (3000, 3), generator=torch.Generator().manual_seed(3))
    blocks[:2] = torch.tensor([[-(1 << 20), (1 << 20) - 1, 0], [(1 << 20) - 1, -(1 << 20), -1]])
    np.testing.assert_array_equal(unique_blocks(blocks).numpy(), np.unique(blocks.numpy(), axis=0))
