"""The scene: its box, three feature grids, and the decoders that read them."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from torch import Tensor

from ...core.config.nice import NiceConfig
from .decoder_files import load_decoders, shipped_decoders
from .decoders import OccupancyDecoders, color_decoder, random_decoders
from .grids import FeatureGrid

Stage = Literal["middle", "fine", "color"]
OUTSIDE_LOGIT = 100.0  # beyond the box everything is solid
STD = {"middle": 0.01, "fine": 0.0001, "color": 0.01}  # of the features at the start
STEP_M = 0.32  # the box is enlarged to whole steps of this size


class Values(NamedTuple):
    """logits (R, S) of occupancy, and colours (R, S, 3), None where the stage has none."""

    logits: Tensor
    colors: Tensor | None


class Scene:
    """What is optimised: grids `middle`, `fine`, `color`, and the colour decoder; the occupancy decoders stay."""

    def __init__(self, bound: Tensor, config: NiceConfig, generator: torch.Generator, device: torch.device) -> None:
        """bound (2, 3) metres: lowest and highest corner."""
        self.device, self.config = device, config
        self.bound = enlarged(bound).to(device)
        voxels = {"middle": config.middle_voxel_m, "fine": config.fine_voxel_m, "color": config.color_voxel_m}
        self.grids = {
            name: FeatureGrid.over(self.bound, voxels[name], STD[name], generator, device) for name in STD
        }  # fmt: skip
        self.decoders = choose_decoders(config.decoders).frozen(device)
        self.color_decoder = color_decoder(generator).to(device)

    def values(self, points: Tensor, stage: Stage) -> Values:
        """points (R, S, 3), metres, along R rays, front to back. The plain path, on any device."""
        flat = points.reshape(-1, 3)
        middle = self.grids["middle"].lookup(flat)
        fine = None if stage == "middle" else self.grids["fine"].lookup(flat)
        logits = self.decoders.logits(flat, middle, fine)
        colors = None
        if stage == "color":
            colors = self.colors(flat).view(points.shape)
        inside = ((flat >= self.bound[0]) & (flat <= self.bound[1])).all(1)
        logits = torch.where(inside, logits, torch.full_like(logits, OUTSIDE_LOGIT))
        return Values(logits.view(points.shape[:2]), colors)

    def colors(self, points: Tensor) -> Tensor:
        """(N, 3) metres -> (N, 3), not clipped."""
        return self.color_decoder(points, self.grids["color"].lookup(points))[:, :3]

    def hold(self) -> None:
        """Nothing takes gradients."""
        for part in (*(grid.table for grid in self.grids.values()), self.color_decoder):
            part.requires_grad_(False)

    def learn(self, colors: bool = True) -> None:
        """All grids take gradients, and the colour decoder if `colors`."""
        for grid in self.grids.values():
            grid.table.requires_grad_(True)
        self.color_decoder.requires_grad_(colors)

    def grow(self, bound: Tensor, generator: torch.Generator) -> bool:
        """Reach to bound (2, 3), too; returns whether anything changed."""
        wanted = torch.stack([torch.minimum(self.bound[0], bound[0].to(self.bound)),
                              torch.maximum(self.bound[1], bound[1].to(self.bound))])  # fmt: skip
        if torch.equal(wanted, self.bound):
            return False
        self.bound = enlarged(wanted)
        self.grids = {name: grid.grown(self.bound, generator) for name, grid in self.grids.items()}
        return True

    def to_state(self) -> dict[str, Any]:
        """Plain tensors for `load_state`."""
        return {
            "bound": self.bound,
            "grids": {name: grid.to_state() for name, grid in self.grids.items()},
            "color_decoder": self.color_decoder.state_dict(),
        }

    def load_state(self, state: dict[str, Any]) -> None:
        self.bound = state["bound"].to(self.device)
        self.grids = {name: FeatureGrid.from_state(grid, self.device) for name, grid in state["grids"].items()}
        self.color_decoder.load_state_dict(state["color_decoder"])


def enlarged(bound: Tensor) -> Tensor:
    """The box (2, 3) with its upper end moved up to the next whole step, always at least one more."""
    steps = ((bound[1] - bound[0]).double() / STEP_M + 1e-6).floor() + 1
    return torch.stack([bound[0], bound[0] + (steps * STEP_M).to(bound)])


def choose_decoders(name: str) -> OccupancyDecoders:
    """Those of a file, the shipped ones (empty name), or untrained ones ("random"). Raises ConfigError."""
    if name == "random":
        return random_decoders(0)
    return load_decoders(Path(name)) if name else shipped_decoders()
