"""Meshing of known fields: what is dropped, what is kept, and what each vertex says."""

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.uncle import FieldConfig
from uncle.recon.core.errors import DataError
from uncle.recon.core.mesh import Mesh
from uncle.recon.volume.mesh_extraction import make_mesh, visible_vertices
from uncle.recon.volume.neural_field import NeuralField
from uncle.recon.volume.sparse_grid import SparseGrid

CAMERA = Camera(160, 120, 120.0, 120.0, 79.5, 59.5)
VOXEL = 0.02
ORANGE = (255, 128, 0)


def make_field(distance, sigma=lambda p: torch.full(p.shape[:-1], 0.004)) -> NeuralField:
    """A field over the cube of +- 0.64 m around (0, 0, 1): free where `distance` is positive."""
    grid = SparseGrid(VOXEL)
    grid.allocate(torch.cartesian_prod(torch.arange(-4, 4), torch.arange(-4, 4), torch.arange(2, 10)))
    points = grid.block_positions(torch.arange(len(grid.blocks))).view(-1, 3)
    sdf = distance(points).clamp(-0.08, 0.08)
    color = torch.tensor(ORANGE).expand(len(sdf), 3) / 255
    base = torch.cat([sdf[:, None], color], 1)
    config = FieldConfig(levels=())
    return NeuralField(grid, base, sigma(points), torch.ones_like(sdf, dtype=torch.bool), config, torch.Generator())


def wall(points: torch.Tensor) -> torch.Tensor:
    """A slab from z = 1.203 to z = 1.303: its front is seen from the origin, its back is not."""
    return torch.maximum(1.203 - points[:, 2], points[:, 2] - 1.303)


def ball(points: torch.Tensor, radius: float, centre=(0.1, 0.05, 0.7)) -> torch.Tensor:
    return (points - torch.tensor(centre)).norm(dim=1) - radius


def mesh_of(field: NeuralField, **options) -> Mesh:
    return make_mesh(field, CAMERA, [np.eye(4)], **options)


def test_only_what_was_seen_is_kept():
    field = make_field(wall)
    both = mesh_of(field, clean=False)
    assert ((both.vertices[:, 2] - 1.303) < 0.001).any()
    assert (np.abs(both.vertices[:, 2] - 1.303) < 0.001).mean() > 0.3
    mesh = mesh_of(field)
    assert np.abs(mesh.vertices[:, 2] - 1.203).max() < 0.001
    front = np.abs(both.vertices[:, 2] - 1.203) < 0.001
    assert len(mesh.vertices) > 0.9 * front.sum()
    a, b, c = mesh.vertices[mesh.faces].transpose(1, 0, 2)
    assert (np.cross(b - a, c - a)[:, 2] <= 1e-9).all()  # towards the camera


def test_a_second_camera_sees_the_other_side():
    behind = np.diag([-1.0, 1.0, -1.0, 1.0])  # looking along -z
    behind[2, 3] = 2.5
    mesh = make_mesh(make_field(wall), CAMERA, [np.eye(4), behind])
    assert (np.abs(mesh.vertices[:, 2] - 1.303) < 0.001).mean() > 0.3


def test_floaters_are_removed_and_objects_stay():
    for radius, kept in ((0.03, False), (0.12, True)):
        field = make_field(lambda p, r=radius: torch.minimum(wall(p), ball(p, r)))
        mesh = mesh_of(field)
        assert (mesh.vertices[:, 2] < 1.0).any() == kept
        assert (mesh_of(field, clean=False).vertices[:, 2] < 1.0).any()


def test_colour_and_sigma_are_those_of_the_map():
    field = make_field(wall, sigma=lambda p: 0.01 + 0.005 * p[:, 0])
    mesh = mesh_of(field)
    assert len(mesh.sigma) == len(mesh.colors) == len(mesh.vertices)
    assert (mesh.colors == np.array(ORANGE, np.uint8)).all()
    np.testing.assert_allclose(mesh.sigma, 0.01 + 0.005 * mesh.vertices[:, 0], atol=1e-5)


def test_max_sigma():
    field = make_field(wall, sigma=lambda p: torch.where(p[:, 0] > 0, 0.05, 0.005))
    mesh = mesh_of(field, max_sigma_m=0.01)
    assert mesh.sigma.max() <= 0.01
    assert -0.7 < mesh.vertices[:, 0].min() < -0.5
    assert mesh.vertices[:, 0].max() < 0.02
    with pytest.raises(DataError, match=r"0\.1 cm.*--max-sigma"):
        mesh_of(field, max_sigma_m=0.001)


@pytest.mark.parametrize("voxel", [0.01, 0.03])
def test_other_cell_size_gives_the_same_surface(voxel):
    field = make_field(lambda p: ball(p, 0.25, (0.0, 0.0, 1.0)))
    own, other = mesh_of(field, clean=False), mesh_of(field, clean=False, voxel_size_m=voxel)
    off = np.linalg.norm(other.vertices - np.array([0, 0, 1.0]), axis=1) - 0.25
    assert np.abs(off).max() < 0.1 * VOXEL
    assert len(other.vertices) == pytest.approx(len(own.vertices) * (VOXEL / voxel) ** 2, rel=0.1)
    edges = np.sort(other.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # closed: no sample was missed


def test_no_surface_is_an_error():
    for distance in (lambda p: p[:, 0] * 0 + 0.07, lambda p: p[:, 0] * 0 - 0.07):
        for options in ({}, {"clean": False}, {"voxel_size_m": 0.05}):
            with pytest.raises(DataError, match="no surface"):
                mesh_of(make_field(distance), **options)
    with pytest.raises(DataError):  # there is a surface, but nobody looked at it
        make_mesh(make_field(wall), CAMERA, [np.diag([-1.0, 1.0, -1.0, 1.0])])


def test_seen_vertices_of_a_box(box_room):
    """From one pose a camera sees the walls before it and none behind it."""
    vertices = np.random.default_rng(0).uniform(0, 1, (4000, 3)) * np.array([0, 3.0, 2.5])
    vertices = np.concatenate([vertices, vertices + np.array([4.0, 0, 0])]).astype(np.float32)
    room = box_room.mesh()
    joined = Mesh(np.concatenate([vertices, room.vertices]).astype(np.float32), room.faces + len(vertices))
    seen = visible_vertices(joined, box_room.camera, [box_room.pose(0.0)], 0.02)[: len(vertices)]
    pose = box_room.pose(0.0)
    local = (vertices - pose[:3, 3]) @ pose[:3, :3]
    u, v, z = box_room.camera.project(torch.from_numpy(local).float())
    inside = ((u > 2) & (u < 157) & (v > 2) & (v < 117)).numpy()
    assert seen[inside].all()
    assert not seen[z.numpy() < 0].any()
    assert inside.sum() > 2000
