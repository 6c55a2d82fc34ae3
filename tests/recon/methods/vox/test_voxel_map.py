"""Voxels, the corners that they share, and interpolation between these."""

import pytest
import torch
from torch.nn.functional import grid_sample
from uncle.recon.methods.vox.lookup import corner_weights, trilinear
from uncle.recon.methods.vox.voxels import VoxelMap
from uncle.recon.volume.sparse_grid import CORNERS


@pytest.fixture
def cube() -> VoxelMap:
    """All voxels of 0.2 m from -0.4 to 0.4 in x, y, z: 4 x 4 x 4."""
    voxels = VoxelMap(0.2)
    cells = torch.cartesian_prod(*[torch.arange(-2, 2)] * 3)
    voxels.add_points((cells + 0.5) * 0.2)
    return voxels


def test_neighbours_share_corners(cube):
    assert len(cube) == 64
    assert len(cube.corners.blocks) == 125
    places = cube.corners.blocks[cube.corner_rows]
    assert (places == cube.voxels.blocks[:, None] + CORNERS).all()


def test_points_make_their_voxels_once():
    voxels = VoxelMap(0.2)
    assert voxels.add_points(torch.tensor([[0.01, 0.01, 0.01], [0.19, 0.1, 0.1], [-0.01, 0.1, 0.1]])) == 2
    assert voxels.add_points(torch.tensor([[0.05, 0.05, 0.05], [0.3, 0.1, 0.1]])) == 1
    assert len(voxels.corners.blocks) == 16  # three in a row
    assert len(voxels.corner_rows) == 3


def test_a_restored_map_is_the_same(cube):
    twin = VoxelMap(0.2)
    twin.restore(cube.voxels.blocks, cube.corners.blocks)
    assert torch.equal(twin.corner_rows, cube.corner_rows)
    assert torch.equal(twin.voxels.block_ids(cube.voxels.blocks), torch.arange(64))


def test_a_point_on_a_face_is_within_the_voxel(cube):
    faces = torch.tensor([[0.4, 0.1, 0.1], [0.4, 0.4, 0.4], [-0.4, 0.0, 0.2], [0.41, 0.1, 0.1]])
    ids = cube.containing(faces)
    assert ids.ge(0).tolist() == [True, True, True, False]
    fractions = cube.fractions(faces[:3], ids[:3])
    assert fractions.min() > -1e-5
    assert fractions.max() < 1 + 1e-5


def test_interpolation_is_that_of_grid_sample(cube):
    """Values, and gradients in the table and in the points."""
    torch.manual_seed(0)
    table = torch.randn(125, 5, requires_grad=True)
    points = (torch.rand(400, 3) * 0.78 - 0.39).requires_grad_()
    pull = torch.randn(400, 5)
    ids = cube.containing(points.detach())
    value = trilinear(table, cube.corner_rows[ids], cube.fractions(points, ids))
    found = torch.autograd.grad((value * pull).sum(), (table, points))

    x, y, z = (cube.corners.blocks + 2).unbind(1)
    dense = torch.zeros(5, 5, 5, 5).index_put((z, y, x), table).permute(3, 0, 1, 2)[None]
    expected = grid_sample(dense, (points / 0.4)[None, None, None], align_corners=True)[0, :, 0, 0].T
    oracle = torch.autograd.grad((expected * pull).sum(), (table, points))
    torch.testing.assert_close(value, expected, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(found[0], oracle[0], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(found[1], oracle[1], atol=1e-3, rtol=1e-4)


def test_weights_of_corners_are_in_their_order():
    assert torch.equal(corner_weights(CORNERS.float()), torch.eye(8))
    torch.testing.assert_close(corner_weights(torch.rand(7, 3)).sum(1), torch.ones(7))
