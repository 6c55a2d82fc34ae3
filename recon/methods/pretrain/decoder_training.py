"""Training of the occupancy decoders on cubes of synthetic rooms whose feature grids are optimised beside them.

The grids go through what mapping does to them: they start near zero, the middle one moves first, then both at the fine
stage's rates. The decoders learn to read features that were found in this way (an auto-decoder), so no encoder is
needed, and training differs from use in the loss alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ..nice.decoders import (
    CHANNELS,
    EMBEDDING,
    OCCUPANCY_SLOPE,
    SKIP_AFTER,
    Decoder,
    OccupancyDecoders,
    linear_layers,
    random_decoders,
)  # fmt: skip
from .cubes import WORLD_M, CubeBatch, cube_logits, cube_losses
from .grids import INITIAL_STD


@dataclass(frozen=True)
class DecoderTraining:
    """Settings of the training; every one is recorded with the weights."""

    steps: int = 4000
    seed: int = 0
    cubes: int = 24  # trained at once
    points: int = 512  # of each cube in a step
    pool: int = 8192  # of each cube in its life
    life: int = 96  # steps until a cube is replaced by a new one
    groups: int = 12  # cubes are replaced one group after the other
    learning_rate: float = 3e-3  # of the decoders; falls to a fiftieth along a cosine
    slope: float = OCCUPANCY_SLOPE  # occupancy = sigmoid(slope * logit) in the loss
    free_logit: float = -0.3  # of features near zero: mildly free
    free_points: int = 2048  # places with features near zero in a step
    free_weight: float = 1.0
    fine_gain: float = 10.0  # of the weights that read fine features, at the start: these move 20 times slower
    embedding_decay: float = 0.1  # decay of the weights that read the embedding, per unit of learning rate and step


class DecoderTrainer:
    """Decoders in training, with the cubes that they learn from."""

    def __init__(self, settings: DecoderTraining, device: torch.device) -> None:
        self.settings, self.device = settings, device
        self.decoders = random_decoders(settings.seed)
        self.done = 0
        self.parameters: list[Tensor] = []
        for decoder in (self.decoders.middle, self.decoders.fine):
            _hush_embedding(decoder)
            self.parameters += decoder.to(device).parameters()
        with torch.no_grad():
            for layer in linear_layers(self.decoders.fine.injection):
                layer.weight[:, :CHANNELS] *= settings.fine_gain
        self.optimizer = torch.optim.AdamW(_groups(self.decoders, settings), lr=settings.learning_rate)
        self.begin_cubes()

    def begin_cubes(self) -> None:
        """Take new cubes, for the steps from the present one on."""
        settings = self.settings
        seed = settings.seed * 1_000_003 + self.done
        self.cubes = CubeBatch(
            settings.cubes, settings.pool, settings.life, torch.Generator(self.device).manual_seed(seed)
        )
        for group in range(settings.groups):
            self.cubes.renew(self._part(group))

    def step(self) -> Tensor:
        """Replace the oldest cubes, move decoders and features; mean losses of middle and middle + fine, (2,)."""
        settings = self.settings
        group, wait = divmod(self.done % settings.life, settings.life // settings.groups)
        if wait == 0:
            self.cubes.renew(self._part(group))
        points, solid = self.cubes.draw(settings.points)
        grids = {name: grid.requires_grad_() for name, grid in self.cubes.grids.values.items()}
        logits = cube_logits(self.decoders, points, self.cubes.features(points), self.cubes.generator)
        losses = cube_losses(logits, solid, settings.slope)
        loss = losses.sum() + settings.free_weight * self.free_loss() * solid.numel()
        gradients = torch.autograd.grad(loss, [*grids.values(), *self.parameters])
        for parameter, gradient in zip(self.parameters, gradients[len(grids) :], strict=True):
            parameter.grad = gradient / solid.numel()
        with torch.no_grad():
            for grid in grids.values():
                grid.requires_grad_(False)
            self.cubes.move(dict(zip(grids, gradients, strict=False)))
        for parameters in self.optimizer.param_groups:
            parameters["lr"] = settings.learning_rate * _schedule(self.done, settings.steps)
        self.optimizer.step()
        self.done += 1
        return losses.detach() / solid.numel()

    def state(self) -> dict[str, Any]:
        """What a broken training needs to go on; the cubes are drawn anew."""
        networks = {"middle": self.decoders.middle.state_dict(), "fine": self.decoders.fine.state_dict()}
        return {"done": self.done, "optimizer": self.optimizer.state_dict(), **networks}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from `state`."""
        self.done = state["done"]
        self.decoders.middle.load_state_dict(state["middle"])
        self.decoders.fine.load_state_dict(state["fine"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.begin_cubes()

    def _part(self, group: int) -> slice:
        size = self.settings.cubes // self.settings.groups
        return slice(group * size, (group + 1) * size)

    def free_loss(self) -> Tensor:
        """Squared distance of the logits of features near zero, as grids start, from a mildly free one."""
        generator, count = self.cubes.generator, self.settings.free_points
        points = (torch.rand(count, 3, generator=generator, device=self.device) * 2 - 1) * WORLD_M
        middle, fine = (
            torch.randn(count, CHANNELS, generator=generator, device=self.device) * INITIAL_STD[name]
            for name in ("middle", "fine")
        )
        coarse = self.decoders.middle(points, middle)
        residual = self.decoders.fine(points, torch.cat([fine, middle], dim=-1))
        return (coarse - self.settings.free_logit).square().mean() + residual.square().mean()


@torch.no_grad()
def _hush_embedding(decoder: Decoder) -> None:
    """Let the decoder start almost without reading the embedding, which says nothing about a new scene."""
    hidden = linear_layers(decoder.hidden)
    for layer in (hidden[0], hidden[SKIP_AFTER + 1]):
        layer.weight[:, :EMBEDDING] *= 0.1


def _groups(decoders: OccupancyDecoders, settings: DecoderTraining) -> list[dict[str, Any]]:
    """Parameters for AdamW: only the first layers decay, which read the embedding alone."""
    networks = (decoders.middle, decoders.fine)
    first = [decoder.hidden[0].weight for decoder in networks]
    rest = [p for decoder in networks for p in decoder.parameters() if p is not decoder.hidden[0].weight]
    return [{"params": first, "weight_decay": settings.embedding_decay}, {"params": rest, "weight_decay": 0.0}]


def _schedule(step: int, steps: int) -> float:
    """Factor of the learning rate: a short warm-up, then down to a fiftieth along a cosine."""
    return min(1.0, (step + 1) / 50) * (0.02 + 0.98 * (0.5 + 0.5 * math.cos(math.pi * step / steps)))
