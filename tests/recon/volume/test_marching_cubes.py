"""Surfaces of known shape, extracted from samples of their exact distance."""

import numpy as np
import pytest
import torch
from uncle.recon.volume.marching_cubes import TILE_BLOCKS, extract_isosurface
from uncle.recon.volume.sparse_grid import BLOCK, SparseGrid

VOXEL = 0.05
TILE_M = TILE_BLOCKS * BLOCK * VOXEL


def extract(distance, low: int, high: int, known=None) -> tuple[np.ndarray, np.ndarray]:
    grid = SparseGrid(VOXEL)
    grid.allocate(torch.cartesian_prod(*[torch.arange(low, high)] * 3))

    def samples(ids: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        positions = grid.block_positions(ids)
        values = distance(positions)
        return values, torch.ones_like(values, dtype=torch.bool) if known is None else known(positions)

    return extract_isosurface(grid, samples)


def edge_counts(faces: np.ndarray) -> np.ndarray:
    """How many faces use each edge."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return np.unique(edges, axis=0, return_counts=True)[1]


def signed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Positive when faces run counter-clockwise seen from outside."""
    a, b, c = vertices[faces].astype(np.float64).transpose(1, 0, 2)
    return float((np.cross(a, b) * c).sum() / 6)


@pytest.mark.parametrize("centre", [(0.013, -0.021, 0.037), (0.6 * TILE_M, 0.007, -0.4 * TILE_M)])
@pytest.mark.parametrize("radius", [0.4, 0.75])
def test_sphere_across_tiles_is_exact_closed_and_faces_outwards(centre, radius):
    middle = torch.tensor(centre)
    vertices, faces = extract(lambda p: (p - middle).norm(dim=-1) - radius, -6, 8)
    off = np.linalg.norm(vertices - middle.numpy(), axis=1) - radius
    assert np.abs(off).max() < 0.1 * VOXEL
    counts = edge_counts(faces)
    assert (counts == 2).all()  # closed, hence seamless
    assert len(np.unique(faces)) == len(vertices)
    assert len(vertices) - len(counts) + len(faces) == 2  # Euler characteristic of one sphere
    assert signed_volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * radius**3, rel=0.03)


def test_spheres_kilometres_apart_are_both_whole():
    """Places so far apart that their coordinates, multiplied, exceed 64 bits."""
    grid, radius = SparseGrid(VOXEL), 0.4
    near = torch.cartesian_prod(*[torch.arange(-3, 3)] * 3)
    far = torch.tensor([100_000, -90_000, 80_000]) * TILE_BLOCKS // 8
    grid.allocate(torch.cat([near, near + far]))

    def samples(ids: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        blocks = grid.blocks[ids]
        local = torch.where(blocks.abs().amax(-1, keepdim=True) > 1000, blocks - far, blocks)
        values = (local[:, None] * grid.block_size_m + grid.inner_offsets() + 0.01).norm(dim=-1) - radius
        return values, torch.ones_like(values, dtype=torch.bool)

    _, faces = extract_isosurface(grid, samples)
    counts = edge_counts(faces)
    assert (counts == 2).all()
    assert len(np.unique(faces)) - len(counts) + len(faces) == 4  # twice the Euler characteristic of a sphere


def test_room_faces_into_its_free_space():
    """Seen from inside: the volume bounded by walls whose normals point inwards is negative."""
    vertices, faces = extract(lambda p: 0.513 - p.abs().amax(-1), -3, 3)
    assert (edge_counts(faces) == 2).all()
    assert signed_volume(vertices, faces) == pytest.approx(-((2 * 0.513) ** 3), rel=0.03)


@pytest.mark.parametrize("offset", [0.0, TILE_M, -TILE_M, VOXEL])
def test_surface_through_the_samples_themselves(offset):
    """Distances of exactly 0, also on the border of two tiles, still make one whole wall."""
    steps = round(offset / VOXEL)
    vertices, faces = extract(lambda p: (torch.round(p[..., 0] / VOXEL) - steps) * VOXEL, -9, 10)
    assert len(faces)
    np.testing.assert_allclose(vertices[:, 0], offset, atol=1e-6)
    a, b, c = vertices[faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2
    assert area == pytest.approx(((19 * BLOCK - 1) * VOXEL) ** 2, rel=1e-4)


def test_unknown_cells_leave_a_hole_and_no_wall():
    radius = 0.6
    vertices, faces = extract(lambda p: p.norm(dim=-1) - radius, -3, 3, known=lambda p: p[..., 2] < 0.31)
    assert np.abs(np.linalg.norm(vertices, axis=1) - radius).max() < 0.1 * VOXEL  # no wall across the opening
    assert vertices[:, 2].max() <= 0.31
    assert vertices[:, 2].max() > 0.31 - 2 * VOXEL
    counts = edge_counts(faces)
    assert set(counts) == {1, 2}
    assert (counts == 1).sum() > 20


def test_nothing_to_extract():
    for distance in (lambda p: p[..., 0] + 10, lambda p: p[..., 0] - 10):
        vertices, faces = extract(distance, -1, 1)
        assert vertices.shape == (0, 3)
        assert faces.shape == (0, 3)
    vertices, _ = extract(lambda p: p[..., 0] - 0.01, -1, 1, known=lambda p: p[..., 0] > 1e9)
    assert len(vertices) == 0
