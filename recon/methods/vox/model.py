"""The implicit surface: embeddings at voxel corners and the network that reads them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor, nn, relu_
from torch.nn.functional import linear

from ...core.config.vox import VoxConfig
from .lookup import trilinear
from .voxels import VoxelMap

_START = 0.01  # standard deviation of new embeddings


class Decoder(nn.Module):
    """Embedding -> two layers -> distance and features; features -> one layer -> colour."""

    def __init__(self, config: VoxConfig, generator: torch.Generator) -> None:
        super().__init__()
        self.first = nn.Linear(config.channels, config.hidden)
        self.second = nn.Linear(config.hidden, config.hidden)
        self.out = nn.Linear(config.hidden, 1 + config.features)  # row 0: the distance
        self.color_first = nn.Linear(config.features, config.hidden)
        self.color_out = nn.Linear(config.hidden, 3)
        for layer in (self.first, self.second, self.out, self.color_first, self.color_out):
            bound = 1 / math.sqrt(layer.in_features)
            for values in (layer.weight, layer.bias):
                nn.init.uniform_(values, -bound, bound, generator=generator)

    def trunk(self, embedding: Tensor) -> Tensor:
        """(N, C) -> (N, hidden)."""
        return relu_(self.second(relu_(self.first(embedding))))

    def distance(self, hidden: Tensor) -> Tensor:
        """(N, hidden) -> (N,) signed distance in truncations, positive before the surface."""
        return linear(hidden, self.out.weight[:1], self.out.bias[:1])[:, 0]

    def color(self, hidden: Tensor) -> Tensor:
        """(N, hidden) -> (N, 3) in 0..1."""
        features = linear(hidden, self.out.weight[1:], self.out.bias[1:])
        return torch.sigmoid(self.color_out(relu_(self.color_first(features))))


class VoxModel:
    """Voxels, embeddings (C, channels) by corner, decoder, and one Adam for both that lasts as long as they do."""

    def __init__(self, config: VoxConfig, device: torch.device, generator: torch.Generator) -> None:
        self.config, self.device, self.generator = config, device, generator
        self.voxels = VoxelMap(config.voxel_size_m, device)
        self.embeddings = nn.Parameter(torch.empty(0, config.channels, device=device))
        self.decoder = Decoder(config, generator).to(device)
        self.optimizer = torch.optim.Adam(
            [{"params": [self.embeddings]}, {"params": [*self.decoder.parameters()]}],
            config.learning_rate,
            fused=device.type == "cuda",
        )

    def embed(self, points: Tensor, ids: Tensor) -> Tensor:
        """(M, 3) world points in the voxels `ids` (M,) -> (M, channels); differentiable in points and embeddings."""
        return trilinear(self.embeddings, self.voxels.corner_rows[ids], self.voxels.fractions(points, ids))

    def precision(self) -> torch.autocast:
        """Within, layers of the decoder compute in bfloat16, if the settings want it."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.bfloat16)

    def add_points(self, points: Tensor) -> None:
        """Voxels around world points (N, 3), with random embeddings at corners that are new."""
        self.voxels.add_points(points)
        missing = len(self.voxels.corners.blocks) - len(self.embeddings)
        if missing:
            new = torch.empty(missing, self.config.channels).normal_(std=_START, generator=self.generator)
            self._grow(new.to(self.device))

    def _grow(self, new: Tensor) -> None:
        """Append rows; the moments of the others stay, as if the new ones had been there without a gradient."""
        old = self.embeddings
        self.embeddings = nn.Parameter(torch.cat([old.detach(), new]))
        state = self.optimizer.state.pop(old, {})
        for name in ("exp_avg", "exp_avg_sq"):
            if name in state:
                state[name] = torch.cat([state[name], torch.zeros_like(new)])
        self.optimizer.param_groups[0]["params"] = [self.embeddings]
        if state:
            self.optimizer.state[self.embeddings] = state

    @contextmanager
    def held(self) -> Iterator[None]:
        """Within, no gradient of what is learned is asked: gradients reach the points alone."""
        learned = [self.embeddings, *self.decoder.parameters()]
        for values in learned:
            values.requires_grad_(False)
        try:
            yield
        finally:
            for values in learned:
                values.requires_grad_(True)

    def to_state(self) -> dict[str, Any]:
        """What was learned, as plain tensors: `map/method_state.pt` of a run."""
        return {
            "voxel_size_m": self.voxels.size_m,
            "voxels": self.voxels.voxels.blocks,
            "corners": self.voxels.corners.blocks,
            "embeddings": self.embeddings.detach(),
            "decoder": self.decoder.state_dict(),
        }

    def state_dict(self) -> dict[str, Any]:
        """`to_state`, and the state of the optimiser."""
        return {**self.to_state(), "optimizer": self.optimizer.state_dict()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from what `state_dict` returned."""
        self.voxels.restore(state["voxels"].to(self.device), state["corners"].to(self.device))
        self._grow(state["embeddings"].to(self.device)[len(self.embeddings) :])
        self.decoder.load_state_dict(state["decoder"])
        self.optimizer.load_state_dict(state["optimizer"])
