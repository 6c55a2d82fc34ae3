"""Block ids against a dictionary, near and far."""

import numpy as np
import pytest
import torch
from numba import njit
from uncle.recon.volume.block_index import RANGE, BlockIndex, block_of, in_range, pack, unpack
from uncle.recon.volume.sparse_grid import BLOCK, ROWS, SparseGrid, unique_blocks

CPU = torch.device("cpu")


def cube(side: int, corner: tuple[int, int, int] = (0, 0, 0)) -> torch.Tensor:
    """All block coordinates of a cube."""
    return torch.cartesian_prod(*[torch.arange(side)] * 3) + torch.tensor(corner)


@njit
def found_by_loop(blocks, volume, origin, far):
    ids = np.empty(len(blocks), np.int64)
    for number in range(len(blocks)):
        ids[number] = block_of(blocks[number, 0], blocks[number, 1], blocks[number, 2], volume, origin, far)
    return ids


def memory(index: BlockIndex) -> int:
    return sum(part.nbytes for part in index.lookup() if part is not None)


SETS = {
    "one room": [cube(12)],
    "a far frame in the middle": [cube(6), cube(4, (6250, 1875, 625)), cube(12), cube(13, (-2, 0, 0))],
    "a far frame first": [cube(4, (600_000, -600_000, 3)), cube(9), cube(14)],
    "three rooms, kilometres apart": [cube(9, (k * 20_000, 0, -k * 9_000)) for k in (0, 1, 2, 0, 1, 2)],
    "a far frame in one call": [torch.cat([cube(10), cube(3, (100_000, 7, 7))])],
    "the ends of the range": [cube(2, (-RANGE, -RANGE, -RANGE)), cube(2, (RANGE - 2, RANGE - 2, RANGE - 2)), cube(5)],
}


@pytest.mark.parametrize("name", SETS)
def test_every_block_is_found_and_no_other(name):
    grid = SparseGrid(0.02)
    for part in SETS[name]:
        grid.allocate(part)
    blocks = grid.blocks
    expected = {tuple(block): number for number, block in enumerate(blocks.tolist())}
    assert len(expected) == len(blocks)
    steps = torch.cartesian_prod(*[torch.tensor([-1, 0, 1])] * 3)
    asked = (blocks[:, None] + steps).view(-1, 3)
    wanted = torch.tensor([expected.get(tuple(block), -1) for block in asked.tolist()])
    restored = SparseGrid(0.02)
    restored.restore(blocks)
    for candidate in (grid, restored):
        torch.testing.assert_close(candidate.block_ids(asked), wanted)
        np.testing.assert_array_equal(found_by_loop(asked.numpy(), *candidate.lookup()), wanted.numpy())
        rows = candidate.sample_rows(asked * BLOCK + BLOCK - 1)
        torch.testing.assert_close(rows, torch.where(wanted >= 0, wanted * ROWS + ROWS - 1, -1))
        low, extent = candidate.extent()
        assert bool((blocks >= low).all())
        assert bool((blocks < low + extent).all())


def test_memory_grows_with_the_blocks_and_not_with_their_extent():
    near, far = BlockIndex(CPU), BlockIndex(CPU)
    blocks = cube(20)
    near.add(blocks, len(blocks))
    far.add(torch.cat([blocks, cube(4, (600_000, 600_000, 600_000))]), len(blocks) + 64)
    assert memory(far) < 2 * memory(near) + (1 << 24)
    long = torch.stack([torch.arange(0, 400_000, 40)] * 3, 1)  # on a diagonal, each far from the next
    spread = BlockIndex(CPU)
    spread.add(long, len(long))
    assert memory(spread) < (1 << 24) + 2000 * len(long)
    torch.testing.assert_close(spread.find(long), torch.arange(len(long)))


def test_most_blocks_are_in_the_dense_box_although_the_first_are_far():
    grid = SparseGrid(0.02)
    for part in (cube(3, (50_000, 0, 0)), cube(10), cube(30)):
        grid.allocate(part)
    assert len(grid.lookup().far) == 27


def test_keys_are_in_the_order_of_coordinates():
    blocks = torch.randint(-RANGE, RANGE, (2000, 3), generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(unpack(pack(blocks)), blocks)
    order = np.lexsort(blocks.numpy().T[::-1])
    torch.testing.assert_close(pack(blocks).sort().values, pack(blocks)[torch.from_numpy(order)])
    torch.testing.assert_close(unique_blocks(blocks), blocks[torch.from_numpy(order)])


def test_what_cannot_be_told_apart_is_left_out():
    beyond = torch.tensor([[RANGE, 0, 0], [0, -RANGE - 1, 0], [1, 2, 3]])
    assert in_range(beyond).tolist() == [False, False, True]
    grid = SparseGrid(0.02)
    assert grid.allocate(beyond) == 1
    assert grid.block_ids(beyond).tolist() == [-1, -1, 0]
