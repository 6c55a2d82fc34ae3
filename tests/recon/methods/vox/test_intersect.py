"""Voxels on a ray against trying every voxel."""

import numpy as np
import pytest
import torch
from uncle.recon.methods.vox.intersect import intersect, intersect_tensors
from uncle.recon.volume.sparse_grid import SparseGrid

SIZE = 0.2


@pytest.fixture
def voxels() -> SparseGrid:
    grid = SparseGrid(SIZE / 8)
    cells = torch.from_numpy(np.random.default_rng(0).integers(-6, 7, (500, 3)))
    grid.allocate(cells)
    return grid


def rays(count: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Some start outside all voxels, some within, some run along an axis or in a plane of axes."""
    rng = np.random.default_rng(1)
    origins = rng.uniform(-2, 2, (count, 3)).astype(np.float32)
    directions = rng.normal(size=(count, 3)).astype(np.float32)
    directions[:20, 0] = 0
    directions[10:30, 1] = 0
    return torch.from_numpy(origins), torch.from_numpy(directions)


def brute_force(voxels: SparseGrid, origin: np.ndarray, direction: np.ndarray, far: float) -> list[tuple]:
    """(entry, exit, id) of all voxels on the ray, by slabs, near to far."""
    low = voxels.blocks.numpy() * SIZE
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origin) / direction, (low + SIZE - origin) / direction
    parallel = direction == 0
    outside = ((origin < low) | (origin >= low + SIZE)) & parallel
    entry = np.where(parallel, -np.inf, np.minimum(a, b)).max(1).clip(0)
    exit = np.minimum(np.where(parallel, np.inf, np.maximum(a, b)).min(1), far)
    hit = (exit - entry > 1e-5) & ~outside.any(1)
    return sorted(zip(entry[hit], exit[hit], np.flatnonzero(hit), strict=True))


@pytest.mark.parametrize("method", [intersect, intersect_tensors])
@pytest.mark.parametrize(("far", "most"), [(np.inf, 40), (1.3, 40), (np.inf, 3)])
def test_hits_are_those_of_brute_force(voxels, method, far, most):
    origins, directions = rays(300)
    hits = method(voxels, origins, directions, torch.full((300,), far), most)
    compared = 0
    for ray in range(300):
        expected = brute_force(voxels, origins[ray].double().numpy(), directions[ray].double().numpy(), far)[:most]
        there = (hits.ids[ray] >= 0) & (hits.exit[ray] - hits.entry[ray] > 1e-5)
        found = torch.stack([hits.entry[ray], hits.exit[ray], hits.ids[ray].float()], 1)[there].numpy()
        assert len(found) == len(expected)
        np.testing.assert_allclose(found, np.array(expected).reshape(-1, 3), atol=2e-5)
        compared += len(found)
    assert compared > 150


def test_rays_that_meet_nothing_have_no_hit(voxels):
    away = torch.tensor([[5.0, 5.0, 5.0]])
    for method in (intersect, intersect_tensors):
        hits = method(voxels, away, torch.ones(1, 3), torch.tensor([np.inf]), 4)
        assert (hits.ids == -1).all()
        assert not hits.entry.any()
        assert not hits.exit.any()


def test_voxels_kilometres_away_change_nothing(voxels):
    """They are found by rays beside them, and cost the others nothing."""
    origins, directions = rays(200)
    expected = intersect(voxels, origins, directions, torch.full((200,), 8.0), 12)
    shift = torch.tensor([5_000, -700, 90_000])
    voxels.allocate(voxels.blocks[:200] + shift)
    found = intersect(voxels, origins, directions, torch.full((200,), 8.0), 12)
    torch.testing.assert_close(found.ids, expected.ids)
    torch.testing.assert_close(found.entry, expected.entry, atol=1e-3, rtol=0)  # counted from another corner
    centre = (voxels.blocks[200 + 300 : 200 + 301] + 0.5) * SIZE
    hits = intersect(voxels, centre.float(), torch.tensor([[0.0, 0.0, 1.0]]), torch.tensor([0.05]), 1)
    assert hits.ids[0, 0] == 500
