"""A small model of a wall, and rays that look at it."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from torch import Tensor
from uncle.recon.core.config.vox import VoxConfig
from uncle.recon.methods.vox.losses import Targets
from uncle.recon.methods.vox.mapping import hit_alone, sample_rays
from uncle.recon.methods.vox.model import VoxModel
from uncle.recon.methods.vox.sampling import Samples


@dataclass
class Scene:
    """A model in double precision, rays (N, 3), (N, 3), what they saw, and samples on them."""

    model: VoxModel
    origins: Tensor
    directions: Tensor
    targets: Targets
    samples: Samples

    def points(self) -> Tensor:
        ray, z, _ = self.samples.packed()
        return self.origins[ray] + self.directions[ray] * z[:, None]


@pytest.fixture
def wall() -> Scene:
    """Voxels around the plane z = 1.03, random embeddings of some size, and two sensors: the second one reads 3 cm
    too far, and every third of its readings is missing; the last ray meets no voxel."""
    config = VoxConfig(channels=6, hidden=12, features=5)
    generator = torch.Generator().manual_seed(3)
    model = VoxModel(config, torch.device("cpu"), generator)
    x, y = torch.meshgrid(torch.linspace(-0.5, 0.5, 12), torch.linspace(-0.4, 0.4, 12), indexing="ij")
    model.add_points(torch.stack([x, y, torch.full_like(x, 1.03)], -1).view(-1, 3))
    model.add_points(torch.stack([x, y, torch.full_like(x, 0.75)], -1).view(-1, 3)[::7])
    model.embeddings.data = torch.randn(model.embeddings.shape, generator=generator, dtype=torch.float64)
    model.decoder.double()
    count = 40
    origins = torch.zeros(count, 3, dtype=torch.float64)
    directions = torch.rand(count, 3, generator=generator, dtype=torch.float64) * 0.7 - 0.35
    directions[:, 2] = 1
    directions[-1, 0] = 5
    depths = torch.full((count, 2), 1.03, dtype=torch.float64)
    depths[:, 1] += 0.03
    depths[::3, 1] = 0
    colors = torch.rand(count, 3, generator=generator, dtype=torch.float64)
    offset = torch.rand(count, generator=generator)
    samples = sample_rays(model, origins.float(), directions.float(), depths.float(), offset)
    samples = Samples(samples.z.double(), samples.there, samples.voxels, samples.index)
    return Scene(model, origins, directions, hit_alone(Targets(colors, depths, depths > 0), samples), samples)


@pytest.fixture(autouse=True)
def one_thread():
    """Models this small gain nothing by threads, and lose much where other programs keep the cores busy."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)
