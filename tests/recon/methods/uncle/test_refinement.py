"""Refinement moves a shifted field back to where noiseless rays say the surface is."""

from dataclasses import replace

import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.config.uncle import FieldConfig
from uncle.recon.core.events import Progress
from uncle.recon.methods.uncle import refinement as refinement
from uncle.recon.methods.uncle.ray_batch import RayBatch
from uncle.recon.methods.uncle.refinement import refine, refine_map, render_rays, surface_depths
from uncle.recon.volume.neural_field import NeuralField
from uncle.recon.volume.sparse_grid import SparseGrid
from uncle.recon.volume.tsdf_volume import TsdfVolume

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
VOXEL, SHIFT, FAR, STEP, BETA = 0.02, 0.01, 3.0, 0.06, 0.05


@pytest.fixture
def scene() -> tuple[NeuralField, RayBatch, torch.Tensor]:
    """A slanted plane fused 1 cm too far away, exact rays to it, and their true depths."""
    return make_scene(FieldConfig(iterations=150, rays=512, learning_rate_sdf_m=1e-3, learning_rate=2e-3))


def make_scene(config: FieldConfig) -> tuple[NeuralField, RayBatch, torch.Tensor]:
    volume, rays = shifted_volume()
    field = NeuralField.from_fusion(volume, 3, config, torch.Generator().manual_seed(0))
    return field, rays, rays.depths[:, 0]


def shifted_volume() -> tuple[TsdfVolume, RayBatch]:
    true = 1.0 / (1.0 - 0.3 * CAMERA.rays()[..., 0] + 0.1 * CAMERA.rays()[..., 1])
    volume = TsdfVolume(SparseGrid(VOXEL), CAMERA, 4 * VOXEL, 2.5)
    color = torch.tensor([51, 102, 204], dtype=torch.uint8).expand(60, 80, 3)
    volume.allocate(true + SHIFT, torch.eye(4))
    for _ in range(3):
        volume.integrate(true + SHIFT, None, color, torch.eye(4))
    depths = true.reshape(-1, 1)
    rays = RayBatch(
        torch.zeros(4800, 3), CAMERA.rays().view(-1, 3), depths, torch.full_like(depths, BETA), torch.ones(1),
        color.reshape(-1, 3),
    )  # fmt: skip
    return volume, rays


def run(field: NeuralField, *rays: RayBatch, on_event=lambda event: None) -> list[float]:
    return refine(field, rays, field.config, FAR, STEP, torch.Generator().manual_seed(0), on_event)


def hit_depth(field: NeuralField, rays: RayBatch) -> torch.Tensor:
    """(N,) depths at which the rays hit the field."""
    return surface_depths(field, field.sdf_table(), rays, FAR, STEP)


def inner(depth: torch.Tensor) -> torch.Tensor:
    """Without the border of the image, where rays leave what is known."""
    return depth.view(60, 80)[8:-8, 8:-8]


def test_shifted_field_moves_back(scene):
    field, rays, true = scene
    before = inner(hit_depth(field, rays) - true)
    assert float(before.abs().median()) == pytest.approx(SHIFT, rel=0.1)
    events = []
    losses = run(field, rays, on_event=events.append)
    after = inner(hit_depth(field, rays) - true)
    assert float(after.abs().median()) < SHIFT / 3
    assert float(after.abs().mean()) < SHIFT / 2
    assert losses[-1] < losses[0] - 0.05
    assert len(losses) == 150
    assert [event for event in events if isinstance(event, Progress)][-1].done == 150


def test_free_space_keeps_its_distances(scene):
    """What refinement never samples must not drift."""
    field, rays, _ = scene
    far = field.known & (field.base[:, 0] > 3.5 * VOXEL)
    before = field.sdf_table()[far]
    run(field, rays)
    assert far.sum() > 100
    torch.testing.assert_close(field.sdf_table()[far], before)


def test_rendered_depth_is_the_depth_of_the_surface(scene):
    field, rays, true = scene
    surface = hit_depth(field, rays)
    z = surface[:, None] + torch.linspace(-0.06, 0.06, 25)
    rendered = render_rays(field, rays.origins, rays.directions, z, field.config.sharpness_voxels)
    error = inner(rendered.depth.detach() - true - SHIFT)
    assert float(error.abs().median()) < 7e-4
    assert float(error.abs().max()) < 5e-3
    assert inner(rendered.known).all()
    torch.testing.assert_close(inner(rendered.color[:, 2]).detach(), torch.full((44, 64), 0.8), atol=0.06, rtol=0)


def test_no_iterations_no_change():
    field, rays, _ = make_scene(FieldConfig(iterations=0))
    before = field.sdf_table()
    assert run(field, rays) == []
    assert torch.equal(field.sdf_table(), before)


def test_no_ray_is_no_change():
    field, rays, _ = make_scene(FieldConfig(iterations=5))
    before = field.sdf_table()
    assert run(field) == []
    assert run(field, replace(rays, directions=-rays.directions)) == []  # every ray misses
    assert torch.equal(field.sdf_table(), before)


def test_same_seed_same_field():
    tables = []
    for _ in range(2):
        field, rays, _ = make_scene(FieldConfig(iterations=10, rays=256))
        run(field, rays)
        tables.append(field.sdf_table())
    assert torch.equal(*tables)


def refined_offset(reliability: float) -> float:
    """Metres behind the truth where the field ends, 1 cm at first: a sensor of some reliability measures it there,
    photometric depth with the same beta measures the truth."""
    field, rays, true = make_scene(FieldConfig(iterations=150, rays=512, learning_rate_sdf_m=1e-3, learning_rate=2e-3))
    sensor = replace(rays, depths=rays.depths + SHIFT, reliability=torch.full((1,), reliability))
    color = replace(rays, colors=None)
    run(field, sensor, color)
    return float(inner(hit_depth(field, rays) - true).median())


def test_sensors_are_weighted_by_their_reliability():
    assert refined_offset(reliability=0.1) < 0.3 * SHIFT
    assert refined_offset(reliability=10.0) > 0.7 * SHIFT


def test_a_step_has_as_many_rays_with_one_set_as_with_two(scene, monkeypatch):
    field, rays, _ = scene
    rendered = []
    render = refinement.render_rays
    monkeypatch.setattr(refinement, "render_rays", lambda *args: rendered.append(len(args[1])) or render(*args))
    field.config = field.config.model_copy(update={"iterations": 2})
    run(field, rays)
    run(field, rays, replace(rays, colors=None))
    assert rendered == [512, 512, 256, 256, 256, 256]


def test_a_missing_measurement_has_no_influence(scene):
    """A second source that never measures, and whose beta is 0 there as in any image of beta."""
    field, rays, _ = scene
    nothing = torch.zeros_like(rays.depths)
    wide = replace(
        rays, depths=torch.cat([rays.depths, nothing], 1), betas=torch.cat([rays.betas, nothing], 1),
        reliability=torch.ones(2),
    )  # fmt: skip
    losses = run(field, wide)
    other, _, _ = make_scene(field.config)
    assert losses == run(other, rays)
    assert torch.equal(field.sdf_table(), other.sdf_table())


def test_a_batch_without_rays_that_hit_the_field_is_left_out(scene):
    field, rays, _ = scene
    losses = run(field, rays, replace(rays, directions=-rays.directions))
    other, _, _ = make_scene(field.config)
    assert losses == run(other, rays)


@pytest.mark.parametrize(("photometric", "ratio"), [(True, 1.0), (False, 0.1)])
def test_without_photometric_depth_the_learning_rate_is_reduced(photometric, ratio):
    """The map of a config with learning rate r is then that of a config with a tenth of it."""
    config = make_config("uncle", ["field.iterations=5", "field.rays=128", "field.learning_rate=0.01"])
    expected = config.model_copy(
        update={"field": config.field.model_copy(update={"learning_rate": 0.01 * ratio})}
    )  # fmt: skip
    volume, rays = shifted_volume()
    refined, losses = refine_map(volume, [rays], config, photometric)
    other, other_losses = refine_map(volume, [rays], expected, photometric=True)
    assert losses == other_losses
    assert len(losses) == 5
    assert torch.equal(refined.sdf_table(), other.sdf_table())
