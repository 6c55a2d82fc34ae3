"""A plane as the map shows it, from several sides."""

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.volume.sparse_grid import SparseGrid
from uncle.recon.volume.tsdf_surface import TsdfSurface

CAMERA = Camera(64, 48, 50.0, 50.0, 31.5, 23.5)
WALL_M = 2.03


@pytest.fixture(scope="module")
def wall() -> TsdfSurface:
    """The plane z = WALL_M, of which the half x > 0 was not seen often enough."""
    grid = SparseGrid(0.05)
    grid.allocate(torch.cartesian_prod(torch.arange(-6, 6), torch.arange(-6, 6), torch.arange(3, 7)))
    positions = grid.block_positions(torch.arange(len(grid.blocks))).view(-1, 3)
    return TsdfSurface(grid, (WALL_M - positions[:, 2]).clamp(-0.2, 0.2), positions[:, 0] <= 0.01, 4.0, 0.15)


def turned(angle: float) -> np.ndarray:
    """Looking at the middle of the left half of the wall, after a turn around the vertical axis."""
    T = np.eye(4)
    T[0, 0] = T[2, 2] = np.cos(angle)
    T[0, 2], T[2, 0] = np.sin(angle), -np.sin(angle)
    T[:3, 3] = np.array([-1.0, 0.0, WALL_M]) - 1.5 * T[:3, 2]
    return T


@pytest.mark.parametrize("angle", [0.0, 0.3, -0.4])
def test_depth_is_along_the_optical_axis(wall, angle):
    pose = turned(angle)
    depth = wall.depth_from(CAMERA, pose)
    rays = CAMERA.rays().numpy() @ pose[:3, :3].T
    expected = (WALL_M - pose[2, 3]) / rays[..., 2]
    x = pose[0, 3] + rays[..., 0] * expected
    y = pose[1, 3] + rays[..., 1] * expected
    seen = (x < -0.1) & (x > -2.2) & (np.abs(y) < 2.2)
    assert seen.mean() > 0.5
    np.testing.assert_allclose(depth[seen], expected[seen], atol=2e-3)
    assert (depth[x > 0.1] == 0).all()


def test_stride_takes_every_nth_pixel(wall):
    whole = wall.depth_from(CAMERA, turned(0.2))
    np.testing.assert_array_equal(wall.depth_from(CAMERA, turned(0.2), stride=5), whole[::5, ::5])


def test_typical_distance_is_the_median_of_what_is_seen(wall):
    assert wall.median_depth(CAMERA, turned(0.0)) == pytest.approx(1.5, abs=2e-3)
    assert wall.median_depth(CAMERA, turned(np.pi)) is None
