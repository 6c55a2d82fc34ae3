"""Readings along rays: from keyframes with their noise models, and from what colour was confronted with."""

from types import SimpleNamespace

import torch
from uncle.recon.core.config.uncle import UncertaintyConfig
from uncle.recon.methods.uncle.ray_batch import RayBatch
from uncle.recon.methods.uncle.ray_buffer import RayBuffer
from uncle.recon.sensors.noise_inputs import FEATURES
from uncle.recon.sensors.noise_model import START_BETA_M, NoiseModel

CPU = torch.device("cpu")


def stored(features: int) -> RayBuffer:
    generator, rays = torch.Generator().manual_seed(0), RayBuffer(100)
    rays.add(
        {
            "frames": torch.zeros(6, dtype=torch.int64), "origins": torch.randn(6, 3, generator=generator),
            "directions": torch.randn(6, 3, generator=generator),
            "depths": torch.tensor([[1.0, 0.0], [2.0, 2.1], [0.0, 3.0], [1.5, 1.4], [0.0, 1.0], [1.0, 1.0]]),
            "colors": torch.arange(18, dtype=torch.uint8).view(6, 3),
            "features": torch.randn(6, 2, features, generator=generator).half(),
        },
        generator,
    )  # fmt: skip
    return rays


def models() -> dict[str, NoiseModel]:
    return {
        name: NoiseModel(UncertaintyConfig(), torch.Generator().manual_seed(seed)) for seed, name in enumerate("ab")
    }


def test_sensors_state_their_noise_and_what_they_are_worth():
    rays, noise = stored(len(FEATURES)), models()
    readings = RayBatch.of_sensors(rays, noise, {"b": 0.25, "a": 1.5})
    assert len(readings) == 6
    assert readings.worth.tolist() == [1.5, 0.25]
    assert torch.equal(readings.betas > 0, rays["depths"] > 0)
    for column, model in enumerate(noise.values()):
        read = rays["depths"][:, column] > 0
        expected = model(rays["features"][read, column].float())
        torch.testing.assert_close(readings.betas[read, column], expected.detach())


def test_without_uncertainty_all_are_alike():
    readings = RayBatch.of_sensors(stored(0), models(), {"a": 1.0, "b": 1.0})
    assert (readings.betas == START_BETA_M).all()


def test_some_of_them():
    readings = RayBatch.of_sensors(stored(len(FEATURES)), models(), {"a": 1.0, "b": 1.0})
    some = readings.at(torch.tensor([4, 1]))
    assert torch.equal(some.depths, readings.depths[[4, 1]])
    assert torch.equal(some.colors, readings.colors[[4, 1]])
    assert torch.equal(some.worth, readings.worth)


def test_colour_reads_from_where_its_views_were_taken():
    told = {"directions": torch.randn(3, 3), "color": torch.tensor([1.0, 2.0, 3.0])}
    told |= {"beta": torch.tensor([0.1, 0.2, 0.3]).half()}
    origins = torch.randn(3, 3)
    readings = RayBatch.of_color(SimpleNamespace(samples=told, origins=lambda: origins), CPU)
    assert readings.depths.shape == readings.betas.shape == (3, 1)
    assert torch.equal(readings.origins, origins)
    assert torch.equal(readings.directions, told["directions"])
    assert readings.worth.tolist() == [1.0]
    assert readings.colors is None
    some = readings.at(torch.tensor([2]))
    assert some.colors is None
    assert some.depths.tolist() == [[3.0]]
