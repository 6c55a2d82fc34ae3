"""Pixels of the keyframes, kept for learning."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from ...mvs.bias_model import BiasModel


class RayBuffer:
    """Pixels of the keyframes with all that learning needs; of bounded size.

    frames (N,) int64 indices; origins, directions (N, 3); depths (N, sensors) metres, 0 = no reading;
    colors (N, 3) uint8; features (N, sensors, F) float16.
    """

    FIELDS = ("frames", "origins", "directions", "depths", "colors", "features")

    def __init__(self, capacity: int) -> None:
        self.capacity = capacity
        self.columns: dict[str, Tensor] = {}

    def __len__(self) -> int:
        return len(self.columns["depths"]) if self.columns else 0

    def __getitem__(self, name: str) -> Tensor:
        return self.columns[name]

    def add(self, rays: dict[str, Tensor], generator: torch.Generator) -> None:
        """Append; when full, random rays make place, so that all keyframes stay represented."""
        if self.columns:
            rays = {name: torch.cat([self.columns[name], rays[name]]) for name in self.FIELDS}
        if len(rays["depths"]) > self.capacity:
            kept = torch.randperm(len(rays["depths"]), generator=generator)[: self.capacity].sort().values
            rays = {name: rays[name][kept] for name in self.FIELDS}
        self.columns = rays

    def move(self, motions: dict[int, Tensor]) -> None:
        """The rays of frames follow their cameras: index -> T_new_old (4, 4), in world axes."""
        if motions:
            self.columns |= {name: self[name].clone() for name in ("origins", "directions")}  # rows may share memory
        for index, motion in motions.items():
            mine = (self["frames"] == index).nonzero()[:, 0]
            motion = motion.to(self["origins"])
            self.columns["origins"][mine] = self["origins"][mine] @ motion[:3, :3].T + motion[:3, 3]
            self.columns["directions"][mine] = self["directions"][mine] @ motion[:3, :3].T


def without_bias(rays: RayBuffer, models: Mapping[str, BiasModel]) -> RayBuffer:
    """`rays` with the active bias models, in the order of the columns, subtracted from their depths."""
    corrected = RayBuffer(rays.capacity)
    corrected.columns = dict(rays.columns)
    if len(rays):
        corrected.columns["depths"] = depths = rays["depths"].clone()
        for column, model in enumerate(models.values()):
            if model.believed:
                read = depths[:, column] > 0
                depths[read, column] -= model.of(rays["features"][read, column].float())
        depths.clamp_(min=0)
    return corrected
