"""Cubes of synthetic rooms with the feature grids that are fitted to them, as mapping would."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits

from ..nice.decoders import OCCUPANCY_SLOPE, OccupancyDecoders
from .crops import draw_crops, sample_crops
from .grids import CELLS, EXTENT_M, FeatureGrids, interpolate

MIDDLE_SHARE = 0.4  # of a cube's steps are in the middle stage, as in mapping; see docs/pretraining.md
RATES = {"middle": 0.1, "fine": 0.005}  # of the features, in the stage of that name
FIRST_FRAME_FACTOR = 5.0  # the rates are up to so many times higher: those of the first mapped frame
WORLD_M = 20.0  # the cubes lie within this distance of the world's origin along each axis


class CubeBatch:
    """S cubes: places with known occupancy, and feature grids at some age of their optimisation."""

    def __init__(self, count: int, pool: int, life: int, generator: torch.Generator) -> None:
        """pool: places known of each cube; life: steps from fresh features to the end of the fine stage."""
        self.generator, self.pool, self.life = generator, pool, life
        self.grids = FeatureGrids(count, generator)
        self.factor = torch.ones(count, device=generator.device)  # of the features' rates
        self.places = torch.zeros(count, pool, 3, device=generator.device)
        self.solid = torch.zeros(count, pool, device=generator.device)

    def renew(self, part: slice) -> None:
        """Put new cubes with fresh features in these places."""
        size = len(self.factor[part])
        crops = draw_crops(size, self.generator)
        places, distance = sample_crops(crops, self.pool, EXTENT_M, self.generator)
        self.places[part], self.solid[part] = places, (distance < 0).float()
        self.grids.renew(part)
        self.factor[part] = FIRST_FRAME_FACTOR ** torch.rand(size, generator=self.generator, device=distance.device)

    def draw(self, points: int) -> tuple[Tensor, Tensor]:
        """Some of the known places of every cube, (S, points, 3), and whether they are solid, (S, points)."""
        shape = (len(self.places), points)
        index = torch.randint(self.pool, shape, generator=self.generator, device=self.places.device)
        return self.places.gather(1, index[..., None].expand(-1, -1, 3)), self.solid.gather(1, index)

    def features(self, points: Tensor) -> dict[str, Tensor]:
        """Features of both grids at (S, P, 3); (S, P, 32) each."""
        return {name: interpolate(self.grids.values[name], points) for name in CELLS}

    def move(self, gradients: dict[str, Tensor]) -> None:
        """One step of the features, at the rates of mapping for their ages."""
        middle_stage = self.grids.age < MIDDLE_SHARE * self.life
        middle = torch.where(middle_stage, RATES["middle"], RATES["fine"])
        fine = torch.where(middle_stage, 0.0, RATES["fine"])
        self.grids.step(gradients, {"middle": middle * self.factor, "fine": fine * self.factor})


def cube_logits(
    decoders: OccupancyDecoders, points: Tensor, features: dict[str, Tensor], generator: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Logits (S, P) of middle, and of middle + fine with the former held fixed, at points (S, P, 3).

    Every call puts the cubes at new places of the world, so that the embedding of a position says nothing.
    """
    count = len(points)
    shift = torch.rand(count, 1, 3, generator=generator, device=points.device)
    world = (points + (2 * shift - 1) * WORLD_M).flatten(0, 1)
    middle, fine = (features[name].flatten(0, 1) for name in CELLS)
    coarse = decoders.middle(world, middle)[:, 0]
    residual = decoders.fine(world, torch.cat([fine, middle.detach()], dim=-1))[:, 0]
    return coarse.reshape(count, -1), (coarse.detach() + residual).reshape(count, -1)


def cube_losses(logits: tuple[Tensor, Tensor], solid: Tensor, slope: float = OCCUPANCY_SLOPE) -> Tensor:
    """Summed cross-entropies of middle and of middle + fine, (2,)."""
    return torch.stack([
        binary_cross_entropy_with_logits(slope * logit, solid, reduction="sum") for logit in logits
    ])  # fmt: skip
