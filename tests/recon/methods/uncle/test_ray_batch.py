"""Rays for the refinement: of keyframes with their noise models, and of photometric samples."""

import pytest
import torch
from uncle.recon.core.config.uncle import UncertaintyConfig
from uncle.recon.methods.uncle.ray_batch import photometric_rays, sensor_rays
from uncle.recon.methods.uncle.ray_buffer import Rays
from uncle.recon.mvs.bias_model import BiasModel
from uncle.recon.mvs.photometric_samples import PhotometricSamples
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS
from uncle.recon.sensors.noise_model import START_BETA_M, NoiseModel

CPU = torch.device("cpu")


def make_rays(inputs: int) -> Rays:
    generator = torch.Generator().manual_seed(0)
    return Rays(
        ("a", "b"), frames=torch.zeros(6, dtype=torch.int64), origins=torch.randn(6, 3, generator=generator),
        directions=torch.randn(6, 3, generator=generator),
        depths=torch.tensor([[1.0, 0.0], [2.0, 2.1], [0.0, 3.0], [1.5, 1.4], [0.0, 1.0], [1.0, 1.0]]),
        colors=torch.arange(18, dtype=torch.uint8).view(6, 3),
        inputs=torch.randn(6, 2, inputs, generator=generator).half(),
    )  # fmt: skip


def models() -> dict[str, NoiseModel]:
    """In another order than the columns of the rays."""
    seeds = {"b": 1, "a": 0}
    return {name: NoiseModel(UncertaintyConfig(), torch.Generator().manual_seed(seed)) for name, seed in seeds.items()}


def test_sensors_have_their_beta_and_reliability():
    rays, noise = make_rays(len(SENSOR_INPUTS)), models()
    batch = sensor_rays(rays, noise, {"b": 0.25, "a": 1.5})
    assert len(batch) == 6
    assert batch.reliability.tolist() == [1.5, 0.25]
    assert torch.equal(batch.betas > 0, rays.depths > 0)
    for column, sensor in enumerate(("a", "b")):
        valid = rays.depths[:, column] > 0
        expected = noise[sensor](rays.inputs[valid, column].float())
        torch.testing.assert_close(batch.betas[valid, column], expected.detach())


def test_without_uncertainty_all_betas_are_alike():
    batch = sensor_rays(make_rays(0), models(), {"a": 1.0, "b": 1.0})
    assert (batch.betas == START_BETA_M).all()


def test_some_rows():
    batch = sensor_rays(make_rays(len(SENSOR_INPUTS)), models(), {"a": 1.0, "b": 1.0})
    some = batch.at(torch.tensor([4, 1]))
    assert torch.equal(some.depths, batch.depths[[4, 1]])
    assert torch.equal(some.colors, batch.colors[[4, 1]])
    assert torch.equal(some.reliability, batch.reliability)


def test_active_biases_are_subtracted():
    rays = make_rays(len(SENSOR_INPUTS))
    biases = {s: BiasModel(UncertaintyConfig(), torch.Generator().manual_seed(2)) for s in ("b", "a")}
    assert torch.equal(rays.without_bias(biases).depths, rays.depths)
    biases["b"].active.fill_(True)
    corrected = rays.without_bias(biases).depths
    assert torch.equal(corrected[:, 0], rays.depths[:, 0])
    valid = rays.depths[:, 1] > 0
    expected = rays.depths[valid, 1] - biases["b"](rays.inputs[valid, 1].float()).detach()
    torch.testing.assert_close(corrected[valid, 1], expected.clamp(min=0))
    assert not corrected[~valid, 1].any()


def make_samples() -> PhotometricSamples:
    return PhotometricSamples(
        ("a",), view=torch.zeros(3, dtype=torch.int64), origins=torch.randn(3, 3), directions=torch.randn(3, 3),
        depth=torch.tensor([1.0, 2.0, 3.0]), beta=torch.tensor([0.1, 0.2, 0.3]).half(), map_depth=torch.ones(3),
        sensor_depths=torch.ones(3, 1), sensor_inputs=torch.zeros(3, 1, 4).half(),
    )  # fmt: skip


def test_photometric_rays_start_where_their_views_were_taken():
    samples = make_samples()
    batch = photometric_rays(samples, CPU)
    assert batch.depths.shape == batch.betas.shape == (3, 1)
    assert torch.equal(batch.origins, samples.origins)
    assert torch.equal(batch.directions, samples.directions)
    assert batch.betas[:, 0].tolist() == pytest.approx([0.1, 0.2, 0.3], rel=1e-3)
    assert batch.reliability.tolist() == [1.0]
    assert batch.colors is None
    some = batch.at(torch.tensor([2]))
    assert some.colors is None
    assert some.depths.tolist() == [[3.0]]
