"""The scene: its box, three feature grids and their decoders (docs/uncle-paper.md, Scene representation)."""

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
# Constants of the released code of NICE-SLAM and UncLe-SLAM.
OUTSIDE_LOGIT = 100.0  # outside of the box everything is solid
INITIAL_STD = {"middle": 0.01, "fine": 0.0001, "color": 0.01}  # of the features
STEP_M = 0.32  # the box is enlarged to whole steps of this size


class FieldValues(NamedTuple):
    """logits (R, S) of occupancy; colors (R, S, 3), or None where the stage has none."""

    logits: Tensor
    colors: Tensor | None


class GridScene:
    """Feature grids `middle`, `fine` and `color` with their decoders; those of occupancy are fixed."""

    def __init__(self, bound: Tensor, config: NiceConfig, generator: torch.Generator, device: torch.device) -> None:
        """bound (2, 3) metres: lowest and highest corner."""
        self.device, self.config = device, config
        self.bound = enlarged(bound).to(device)
        voxels = {"middle": config.middle_voxel_m, "fine": config.fine_voxel_m, "color": config.color_voxel_m}
        self.grids = {
            name: FeatureGrid.over(self.bound, voxels[name], std, generator, device)
            for name, std in INITIAL_STD.items()
        }  # fmt: skip
        self.decoders = choose_decoders(config.decoders).frozen(device)
        self.color_decoder = color_decoder(generator).to(device)

    def values(self, points: Tensor, stage: Stage) -> FieldValues:
        """Field at points (R, S, 3), metres, along R rays, on any device; for a CPU see `fast.FastEvaluate`."""
        flat = points.reshape(-1, 3)
        middle = self.grids["middle"].lookup(flat)
        fine = None if stage == "middle" else self.grids["fine"].lookup(flat)
        logits = self.decoders.logits(flat, middle, fine)
        colors = None
        if stage == "color":
            colors = self.colors(flat).view(points.shape)
        inside = ((flat >= self.bound[0]) & (flat <= self.bound[1])).all(1)
        logits = torch.where(inside, logits, torch.full_like(logits, OUTSIDE_LOGIT))
        return FieldValues(logits.view(points.shape[:2]), colors)

    def colors(self, points: Tensor) -> Tensor:
        """Colours (N, 3), not clipped, at points (N, 3), metres."""
        return self.color_decoder(points, self.grids["color"].lookup(points))[:, :3]

    def freeze(self) -> None:
        """Compute no gradients of grids and decoders."""
        for grid in self.grids.values():
            grid.table.requires_grad_(False)
        self.color_decoder.requires_grad_(False)

    def unfreeze(self, colors: bool = True) -> None:
        """Compute gradients of all grids, and of the colour decoder if `colors`."""
        for grid in self.grids.values():
            grid.table.requires_grad_(True)
        self.color_decoder.requires_grad_(colors)

    def grow(self, bound: Tensor, generator: torch.Generator) -> bool:
        """Enlarge the box to include bound (2, 3), metres; returns whether it changed."""
        low = torch.minimum(self.bound[0], bound[0].to(self.bound))
        high = torch.maximum(self.bound[1], bound[1].to(self.bound))
        union = torch.stack([low, high])
        if torch.equal(union, self.bound):
            return False
        self.bound = enlarged(union)
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
        """Restore what `to_state` returned."""
        self.bound = state["bound"].to(self.device)
        self.grids = {name: FeatureGrid.from_state(grid, self.device) for name, grid in state["grids"].items()}
        self.color_decoder.load_state_dict(state["color_decoder"])


def enlarged(bound: Tensor) -> Tensor:
    """The box (2, 3) with its upper corner moved up to the next whole step, always by at least one."""
    steps = ((bound[1] - bound[0]).double() / STEP_M + 1e-6).floor() + 1
    return torch.stack([bound[0], bound[0] + (steps * STEP_M).to(bound)])


def choose_decoders(name: str) -> OccupancyDecoders:
    """Decoders of a file, the shipped ones (empty name), or untrained ones ("random"). Raises ConfigError."""
    if name == "random":
        return random_decoders(0)
    return load_decoders(Path(name)) if name else shipped_decoders()
