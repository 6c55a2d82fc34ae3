"""Feature grids of many cubes at once: lookup, and Adam with the step sizes of mapping."""

from __future__ import annotations

import torch
from torch import Tensor

from ..nice.decoders import CHANNELS

CELLS = {"middle": 4, "fine": 8}  # along the side of a cube: cells of 0.32 m and of 0.16 m
EXTENT_M = 1.28
INITIAL_STD = {"middle": 1e-2, "fine": 1e-4}


def interpolate(grid: Tensor, points: Tensor) -> Tensor:
    """Trilinear features of (S, C, n, n, n) grids, axes z, y, x, at points (S, P, 3) metres from the cubes' centres.

    Vertices lie on the cubes' faces. Returns (S, P, C).
    """
    place = (points * (2.0 / EXTENT_M))[:, :, None, None]
    found = torch.nn.functional.grid_sample(grid, place, align_corners=True, padding_mode="border")
    return found[..., 0, 0].transpose(1, 2)


class FeatureGrids:
    """The middle and fine grids of S cubes and their Adam state, every cube with an age of its own."""

    def __init__(self, count: int, generator: torch.Generator) -> None:
        self.generator = generator
        self.age = torch.zeros(count, device=generator.device)
        self.values = {name: self._fresh(name, count) for name in CELLS}
        self._moments = {name: (torch.zeros_like(grid), torch.zeros_like(grid)) for name, grid in self.values.items()}

    def _fresh(self, name: str, count: int) -> Tensor:
        side = CELLS[name] + 1
        shape = (count, CHANNELS, side, side, side)
        return torch.randn(shape, generator=self.generator, device=self.generator.device) * INITIAL_STD[name]

    def renew(self, part: slice) -> None:
        """Start these cubes again from features near zero."""
        for name, grid in self.values.items():
            grid[part] = self._fresh(name, len(grid[part]))
            for moment in self._moments[name]:
                moment[part] = 0.0
        self.age[part] = 0

    def step(self, gradients: dict[str, Tensor], rates: dict[str, Tensor]) -> None:
        """One step of Adam (0.9, 0.999) with a rate for every cube, (S,); rate 0 leaves its grid alone."""
        self.age += 1
        for name, gradient in gradients.items():
            first, second = self._moments[name]
            first.lerp_(gradient, 0.1)
            second.mul_(0.999).addcmul_(gradient, gradient, value=1e-3)
            size = (rates[name] / (1 - 0.9**self.age))[:, None, None, None, None]
            root = (1 / (1 - 0.999**self.age)).sqrt()[:, None, None, None, None]
            self.values[name] -= size * first / (second.sqrt() * root + 1e-8)
