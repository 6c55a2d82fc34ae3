"""The compiled lookup in the map against that by tensors."""

import numpy as np
import pytest
import torch
from uncle.recon.core.se3 import apply_motion
from uncle.recon.volume.sparse_grid import SparseGrid
from uncle.recon.volume.tsdf_query import query_numba, query_torch
from uncle.recon.volume.tsdf_volume import TsdfVolume

CORNER = 0.785  # the angle at which the camera sees a corner of the room


@pytest.fixture(scope="module")
def corner(box_room) -> TsdfVolume:
    """Three coloured views of the corner, fused."""
    volume = TsdfVolume(SparseGrid(0.03), box_room.camera, 0.15, 6.0)
    for turn in (-0.15, 0.0, 0.15):
        pose = box_room.pose(CORNER + turn)
        depth, T = torch.from_numpy(box_room.depth(pose)).float(), torch.from_numpy(pose).float()
        volume.allocate(depth, T)
        volume.integrate(depth, None, torch.from_numpy(box_room.picture(pose)), T)
    return volume


def test_compiled_lookup_is_that_of_tensors(box_room, corner):
    pose = box_room.pose(CORNER)
    points = torch.from_numpy(box_room.camera.rays().numpy() * box_room.depth(pose)[..., None])[::3, ::3]
    points = points.float().reshape(-1, 3)
    points = points + 0.1 * torch.randn(points.shape, generator=torch.Generator().manual_seed(2))  # some off the map
    T = torch.from_numpy(apply_motion(pose, np.array([0.02, -0.015, 0.025, 0.008, -0.01, 0.006]))).float()
    expected, compiled = query_torch(corner, points, T), query_numba(corner, points, T)
    assert 100 < len(expected.kept) < len(points) - 20
    assert torch.equal(compiled.kept, expected.kept)
    for name in ("sdf", "gradient", "sigma", "grey", "grey_gradient"):
        torch.testing.assert_close(getattr(compiled, name), getattr(expected, name), rtol=1e-3, atol=2e-4)
    assert expected.grey.std() > 0.01, "the pattern of the walls"


def test_no_points(corner):
    nothing = query_numba(corner, torch.zeros(0, 3), torch.eye(4))
    assert len(nothing.kept) == len(nothing.sdf) == 0
