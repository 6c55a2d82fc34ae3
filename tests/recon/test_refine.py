"""Refinement moves a shifted field back to where noiseless rays say the surface is."""

import pytest
import torch
from uncle.recon.camera import Camera
from uncle.recon.config import FieldConfig, UncertaintyConfig
from uncle.recon.events import Progress
from uncle.recon.field import NeuralField
from uncle.recon.fusion import FusionVolume
from uncle.recon.grid import SparseGrid
from uncle.recon.keyframes import RayStore
from uncle.recon.noise_features import FEATURES
from uncle.recon.refine import refine, render_rays, surface_depths
from uncle.recon.uncertainty import NoiseModel

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
VOXEL, SHIFT, FAR, STEP = 0.02, 0.01, 3.0, 0.06


@pytest.fixture
def scene() -> tuple[NeuralField, RayStore, torch.Tensor]:
    """A slanted plane fused 1 cm too far away, exact rays to it, and their true depths."""
    return make_scene(FieldConfig(iterations=150, rays=512, learning_rate_sdf_m=1e-3, learning_rate=2e-3))


def make_scene(config: FieldConfig) -> tuple[NeuralField, RayStore, torch.Tensor]:
    true = 1.0 / (1.0 - 0.3 * CAMERA.rays()[..., 0] + 0.1 * CAMERA.rays()[..., 1])
    volume = FusionVolume(SparseGrid(VOXEL), CAMERA, 4 * VOXEL, 2.5)
    color = torch.tensor([51, 102, 204], dtype=torch.uint8).expand(60, 80, 3)
    volume.allocate(true + SHIFT, torch.eye(4))
    for _ in range(3):
        volume.integrate(true + SHIFT, None, color, torch.eye(4))
    field = NeuralField.from_fusion(volume, 3, config, torch.Generator().manual_seed(0))
    store, depths = RayStore(10_000), true.reshape(-1, 1)
    store.add(
        {
            "origins": torch.zeros(4800, 3), "directions": CAMERA.rays().view(-1, 3), "depths": depths,
            "colors": color.reshape(-1, 3), "features": torch.zeros(4800, 1, len(FEATURES)).half(),
        },
        torch.Generator(),
    )  # fmt: skip
    return field, store, true.view(-1)


def run(field: NeuralField, store: RayStore, on_event=lambda event: None, noise=None) -> list[float]:
    generator = torch.Generator().manual_seed(0)
    noise = {"a": NoiseModel(UncertaintyConfig(), generator)} if noise is None else noise
    return refine(field, store, noise, field.config, FAR, STEP, generator, on_event)


def inner(depth: torch.Tensor) -> torch.Tensor:
    """Without the border of the image, where rays leave what is known."""
    return depth.view(60, 80)[8:-8, 8:-8]


def test_shifted_field_moves_back(scene):
    field, store, true = scene
    before = inner(surface_depths(field, store, FAR, STEP) - true)
    assert float(before.abs().median()) == pytest.approx(SHIFT, rel=0.1)
    events = []
    losses = run(field, store, events.append)
    after = inner(surface_depths(field, store, FAR, STEP) - true)
    assert float(after.abs().median()) < SHIFT / 3
    assert float(after.abs().mean()) < SHIFT / 2
    assert losses[-1] < losses[0] - 0.05
    assert len(losses) == 150
    assert [event for event in events if isinstance(event, Progress)][-1].done == 150


def test_free_space_keeps_its_distances(scene):
    """What refinement never looks at must not drift."""
    field, store, _ = scene
    far = field.known & (field.base[:, 0] > 3.5 * VOXEL)
    before = field.sdf_table()[far]
    run(field, store)
    assert far.sum() > 100
    torch.testing.assert_close(field.sdf_table()[far], before)


def test_rendered_depth_is_the_depth_of_the_surface(scene):
    field, store, true = scene
    surface = surface_depths(field, store, FAR, STEP)
    z = surface[:, None] + torch.linspace(-0.06, 0.06, 25)
    rendered = render_rays(field, store["origins"], store["directions"], z)
    error = inner(rendered.depth.detach() - true - SHIFT)
    assert float(error.abs().median()) < 7e-4
    assert float(error.abs().max()) < 5e-3
    assert inner(rendered.known).all()
    torch.testing.assert_close(inner(rendered.color[:, 2]).detach(), torch.full((44, 64), 0.8), atol=0.06, rtol=0)
    assert (rendered.variance >= 0).all()


def test_no_iterations_no_change():
    field, store, _ = make_scene(FieldConfig(iterations=0))
    before = field.sdf_table()
    assert run(field, store) == []
    assert torch.equal(field.sdf_table(), before)


def test_nothing_to_look_at_is_no_change():
    field, store, _ = make_scene(FieldConfig(iterations=5))
    before = field.sdf_table()
    assert run(field, RayStore(10)) == []
    store.columns["directions"] = -store["directions"]  # every ray misses
    assert run(field, store) == []
    assert torch.equal(field.sdf_table(), before)


def test_same_seed_same_field():
    tables = []
    for _ in range(2):
        field, store, _ = make_scene(FieldConfig(iterations=10, rays=256))
        run(field, store)
        tables.append(field.sdf_table())
    assert torch.equal(*tables)
