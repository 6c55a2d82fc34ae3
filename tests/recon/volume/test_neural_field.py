"""The field: starts as the fused map, is moved only where it is active, and survives its file."""

import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.uncle import FieldConfig
from uncle.recon.core.tensor_files import load_tensors, save_tensors
from uncle.recon.volume.neural_field import ACTIVE_VOXELS, NeuralField
from uncle.recon.volume.sparse_grid import SparseGrid
from uncle.recon.volume.tsdf_volume import TsdfVolume

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
VOXEL = 0.05


@pytest.fixture
def volume() -> TsdfVolume:
    """A slanted plane, seen twice in green."""
    made = TsdfVolume(SparseGrid(VOXEL), CAMERA, 4 * VOXEL, 5.0)
    depth = 2.0 + 0.3 * CAMERA.rays()[..., 0]
    color = torch.tensor([0, 204, 51], dtype=torch.uint8).expand(60, 80, 3)
    made.allocate(depth, torch.eye(4))
    for _ in range(2):
        made.integrate(depth, None, color, torch.eye(4))
    return made


def make_field(volume: TsdfVolume, min_observations: float = 2, **settings) -> NeuralField:
    config = FieldConfig(**settings)
    return NeuralField.from_fusion(volume, min_observations, config, torch.Generator().manual_seed(0))


def shaken(field: NeuralField) -> NeuralField:
    """The same field with random parameters, as if it had learned something."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for values in field.parameters():
            values.add_(torch.randn(values.shape, generator=generator) * 0.005)
        field.fine[0] = 0
    return field


def probes(field: NeuralField, count: int = 3000) -> torch.Tensor:
    positions = field.grid.block_positions(torch.arange(len(field.grid.blocks))).view(-1, 3)
    generator = torch.Generator().manual_seed(2)
    rows = torch.randint(len(positions), (count,), generator=generator)
    return positions[rows] + (torch.rand(count, 3, generator=generator) - 0.5) * VOXEL


def test_confidence_is_stated_by_the_weights_where_they_mean_something(volume):
    plain, stated = make_field(volume), NeuralField.from_fusion(volume, 2, FieldConfig(), torch.Generator(), 0.03)
    assert torch.equal(plain.sigma, volume.samples().sigma)
    assert torch.equal(stated.sigma, volume.samples().propagated_sigma(0.03))
    assert not torch.equal(plain.sigma, stated.sigma)


def test_starts_as_the_fused_map(volume):
    field = make_field(volume)
    points = probes(field)
    sdf, rgb, known = field(points)
    rows, weights = volume.grid.trilinear(points)
    inside = ((rows >= 0) & (volume.counts()[rows.clamp(min=0)] >= 2)).all(1)
    assert torch.equal(known, inside)
    assert 0.2 < known.float().mean() < 0.9
    torch.testing.assert_close(sdf[known], (volume.sdf()[rows] * weights).sum(1)[known])
    near = known & (sdf.abs() < 0.01)
    torch.testing.assert_close(rgb[near], torch.tensor([0.0, 0.8, 0.2]).expand(int(near.sum()), 3), atol=1e-5, rtol=0)
    assert (sdf[~known] == 0).all()
    assert (rgb[~known] == 0).all()
    torch.testing.assert_close(field.sdf_table(), volume.sdf())


def test_too_few_readings_are_unknown(volume):
    field = make_field(volume, min_observations=3)
    assert not field(probes(field))[2].any()


def test_table_and_queries_agree_after_learning(volume):
    """At the samples themselves both ways to ask give the same distance, where the surface is."""
    field = shaken(make_field(volume))
    table = field.sdf_table()
    near = (field.known & (field.base[:, 0].abs() < 2 * VOXEL)).nonzero()[:, 0][::37]
    positions = field.grid.block_positions(torch.arange(len(field.grid.blocks))).view(-1, 3)[near]
    sdf, _, known = field(positions)
    assert known.float().mean() > 0.8
    torch.testing.assert_close(sdf[known].detach(), table[near][known], atol=1e-5, rtol=0)
    assert (table - field.base[:, 0]).abs()[near].max() > 1e-3


def test_state_round_trip_is_exact(volume, tmp_path):
    field = shaken(make_field(volume))
    save_tensors(tmp_path / "field.pt", field.to_state())
    loaded = NeuralField.from_state(load_tensors(tmp_path / "field.pt"))
    assert torch.equal(loaded.sdf_table(), field.sdf_table())
    points = probes(field)
    for found, expected in zip(loaded(points), field(points), strict=True):
        torch.testing.assert_close(found, expected, atol=0.002, rtol=0)  # colours are kept in bytes
    assert torch.equal(loaded(points)[0], field(points)[0])
    torch.testing.assert_close(loaded.sigma, field.sigma, rtol=1e-3, atol=1e-6)


def test_samples_away_from_the_surface_do_not_learn(volume):
    """The gradient of a query reaches the samples near the surface; all others share one slot that stays zero."""
    field = make_field(volume)
    sdf, _, known = field(probes(field))
    sdf[known].square().sum().backward()
    assert (field.fine.grad[0] == 0).all()
    assert field.fine.grad[1:].abs().max() > 0
    inactive = field.base[:, 0].abs() >= ACTIVE_VOXELS * VOXEL
    assert (field.slot[inactive] == 0).all()
    assert (field.slot[field.known & ~inactive] > 0).all()


@pytest.mark.parametrize("levels", [(4, 12), (3,), ()])
def test_gradients_by_finite_differences(volume, levels):
    field = shaken(make_field(volume, levels=levels)).double()
    field.base = field.base.double()
    points = probes(field, 300).double()
    points = points[field(points)[2]]
    points = points[field(points)[0].abs() < VOXEL][:12]
    assert len(points) == 12
    parameters = [field.fine, *(level.features for level in field.levels)]
    for parameter in parameters:
        field.zero_grad()
        sdf, rgb, _ = field(points)
        (sdf.sin().sum() + rgb.square().sum()).backward()
        flat, gradient = parameter.data.view(-1), parameter.grad.view(-1)
        for entry in gradient.abs().argsort(descending=True)[:3]:
            values = []
            for step in (1e-6, -2e-6):
                flat[entry] += step
                sdf, rgb, _ = field(points)
                values.append(float((sdf.sin().sum() + rgb.square().sum()).detach()))
            flat[entry] += 1e-6
            assert (values[0] - values[1]) / 2e-6 == pytest.approx(float(gradient[entry]), rel=1e-4, abs=1e-8)


def test_coarse_levels_cover_the_surface(volume):
    field = make_field(volume, levels=(2, 4, 12))
    points = probes(field)
    sdf, _, known = field(points)
    for level in field.levels:
        rows, _ = level.grid.trilinear(points[known & (sdf.abs() < VOXEL)])
        assert (rows >= 0).all()
