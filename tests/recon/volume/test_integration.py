"""The compiled loop against the same arithmetic as tensor operations."""

import itertools

import pytest
import torch
from uncle.recon.volume.integration import Bounds, Observation, integrate, integrate_tensors
from uncle.recon.volume.sparse_grid import SparseGrid
from uncle.recon.volume.tsdf_volume import FreeSpace, TsdfVolume


def observation(room, weighted: bool, free: bool, colored: bool) -> tuple[Observation, torch.Tensor]:
    """A picture of the room with holes, and its T_world_camera."""
    pose = room.pose(0.4)
    depth, generator = torch.from_numpy(room.depth(pose)).float(), torch.Generator().manual_seed(3)
    depth[torch.rand(depth.shape, generator=generator) < 0.1] = 0.0
    weight = 0.1 + torch.rand(depth.shape, generator=generator) if weighted else None
    space = FreeSpace.from_weight(weight, 0.5, 0.2 * weight) if free else FreeSpace(None, None)
    color = torch.randint(0, 255, (*depth.shape, 3), generator=generator, dtype=torch.uint8) if colored else None
    T_world_camera = torch.from_numpy(pose).float()
    T_camera_world = torch.linalg.inv(T_world_camera)
    return Observation(depth, weight, space.weight, space.scale_m, color, T_camera_world), T_world_camera


@pytest.mark.parametrize(
    ("weighted", "free", "colored"), [c for c in itertools.product([False, True], repeat=3) if c[0] or not c[1]]
)
def test_compiled_equals_tensors(box_room, weighted, free, colored):
    seen, T_world_camera = observation(box_room, weighted, free, colored)
    volume = TsdfVolume(SparseGrid(0.05), box_room.camera, 0.2, 6.0)
    volume.allocate(seen.depth, T_world_camera)
    volume.allocate(0.5 * seen.depth, T_world_camera)  # free space to speak for
    ids = torch.arange(len(volume.grid.blocks))
    corners = volume.grid.blocks[ids].float() * volume.grid.block_size_m
    found, expected = ([torch.zeros(volume.grid.rows, 4) for _ in range(2)] for _ in range(2))
    rest = (ids, corners, volume.grid.inner_offsets(), seen, box_room.camera, Bounds(0.2, 6.0))
    integrate(*found, *rest, 1.0)
    integrate_tensors(*expected, *rest, 1.0)
    # A sample on the border of two pixels may fall to either, by the last bit of its projection.
    for ours, theirs in zip(found, expected, strict=True):
        equal = torch.isclose(ours, theirs, rtol=1e-4, atol=1e-5).all(1)
        assert (~equal).float().mean() < 2e-4
    assert (expected[0][:, 3] > 0).sum() > 10_000
    assert bool((expected[1] != 0).any()) == colored
    before = [table.clone() for table in found]
    integrate(*found, *rest, -1.0)
    for table, was in zip(found, before, strict=True):
        assert table.abs().max() <= 1e-6 * max(1.0, float(was.abs().max()))


def test_threads_change_no_bit(box_room, threads):
    seen, T_world_camera = observation(box_room, weighted=True, free=True, colored=True)
    volume, alone = (TsdfVolume(SparseGrid(0.05), box_room.camera, 0.2, 6.0) for _ in range(2))
    space = FreeSpace(seen.free_weight, seen.free_space_scale_m)
    for target, count in ((volume, threads), (alone, 1)):
        torch.set_num_threads(count)
        target.allocate(seen.depth, T_world_camera)
        target.integrate(seen.depth, seen.weight, seen.color, T_world_camera, space)
    assert alone.sums.any()
    assert torch.equal(volume.sums, alone.sums)
    assert torch.equal(volume.color_sums, alone.color_sums)
