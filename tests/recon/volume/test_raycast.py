"""Rays against surfaces of known distance."""

import pytest
import torch
from uncle.recon.volume.raycast import cast_rays, cast_tensors
from uncle.recon.volume.sparse_grid import SparseGrid

VOXEL, TRUNCATION = 0.02, 0.08


def volume(distance, low: int, high: int) -> tuple[SparseGrid, torch.Tensor, torch.Tensor]:
    """The grid of all blocks low..high, truncated distances by row, and which of them a sensor would know."""
    grid = SparseGrid(VOXEL)
    grid.allocate(torch.cartesian_prod(*[torch.arange(low, high)] * 3))
    sdf = distance(grid.block_positions(torch.arange(len(grid.blocks))).view(-1, 3))
    return grid, sdf.clamp(max=TRUNCATION), sdf > -TRUNCATION


@pytest.fixture(scope="module")
def rays() -> tuple[torch.Tensor, torch.Tensor]:
    """From 1 m in front of the origin, around the z axis; directions with unit z-component."""
    slopes = torch.rand(3000, 2, generator=torch.Generator().manual_seed(0)) - 0.5
    directions = torch.cat([slopes, torch.ones(3000, 1)], 1)
    return torch.tensor([0.0, 0.0, -1.0]).expand(3000, 3), directions


def cast(scene, rays) -> torch.Tensor:
    return cast_rays(*scene, *rays, far_m=3.0, step_m=0.75 * TRUNCATION)


def test_plane(rays):
    normal = torch.nn.functional.normalize(torch.tensor([0.2, -0.1, -1.0]), dim=0)
    depth = cast(volume(lambda p: p @ normal + 0.05, -6, 6), rays)
    origins, directions = rays
    true = -(origins @ normal + 0.05) / (directions @ normal)
    hits = origins + directions * true[:, None]
    inside = (hits.abs() < 0.8).all(1)  # well within the allocated blocks
    assert inside.float().mean() > 0.9
    assert (depth[inside] - true[inside]).abs().max() < 1e-3


def test_sphere_from_outside_and_from_inside(rays):
    radius = 0.5
    scene = volume(lambda p: p.norm(dim=-1) - radius, -5, 5)
    depth = cast(scene, rays)
    origins, directions = rays
    a, b = directions.square().sum(1), (origins * directions).sum(1)
    root = b.square() - a * (1.0 - radius**2)
    true = torch.where(root > 0, (-b - root.clamp(min=0).sqrt()) / a, 0.0)
    grazing = (root > -0.02) & (root < 0.02)
    assert ((depth > 0) == (true > 0))[~grazing].all()  # what misses is 0
    assert (depth - true)[~grazing & (true > 0)].abs().max() < 1e-3
    assert (depth == 0).any()
    room = volume(lambda p: radius - p.norm(dim=-1), -5, 5)
    depth = cast(room, (torch.zeros(3000, 3), directions))
    assert (depth - radius / a.sqrt()).abs().max() < 1e-3


def test_unknown_is_not_hit(rays):
    grid, sdf, known = volume(lambda p: -p[:, 2], -6, 6)
    x = grid.block_positions(torch.arange(len(grid.blocks))).view(-1, 3)[:, 0]
    depth = cast((grid, sdf, known & (x > 0)), rays)
    there = rays[0][:, 0] + rays[1][:, 0]  # x where the ray meets the plane, 1 m ahead
    assert (depth[there < -VOXEL] == 0).all()
    assert (depth[there > 2 * VOXEL] - 1).abs().max() < 1e-3


def test_back_side_is_not_a_surface(rays):
    """Distances that rise along the ray (leaving a solid) are no hit."""
    scene = volume(lambda p: p[:, 2], -6, 6)
    assert (cast(scene, rays) == 0).all()


def test_chunks_do_not_show(rays):
    scene = volume(lambda p: -p[:, 2], -6, 6)
    origins, directions = rays
    many = cast(scene, (origins.repeat(3, 1), directions.repeat(3, 1)))
    torch.testing.assert_close(many, cast(scene, rays).repeat(3))


def test_compiled_equals_tensors(rays):
    """A bumpy surface with unknown samples scattered about: some rays miss, some lose their crossing."""
    grid, sdf, known = volume(lambda p: 0.3 - p[:, 2] + 0.1 * torch.sin(9 * p[:, 0]) * torch.cos(7 * p[:, 1]), -5, 5)
    known &= torch.rand(len(known), generator=torch.Generator().manual_seed(1)) > 0.01
    found = cast_rays(grid, sdf, known, *rays, far_m=3.0, step_m=0.06)
    expected = cast_tensors(grid, sdf, known, *rays, far_m=3.0, step_m=0.06)
    hit = expected > 0
    assert 0.5 < hit.float().mean() < 0.99
    # A point on the border of two samples may fall to either, by the last bit of its position.
    assert ((found > 0) == hit).float().mean() > 0.99
    both = hit & (found > 0)
    assert ((found - expected)[both].abs() < 1e-5).float().mean() > 0.995
