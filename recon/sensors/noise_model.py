"""The uncertainty of a sensor: a small network h_w from image features to the Laplace scale beta of each reading."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.functional import linear, softplus

from ..core.adam import Adam
from ..core.config.uncle import UncertaintyConfig
from ..core.errors import ConfigError
from .likelihood import interval_loss, laplace_nll
from .noise_inputs import FEATURES

START_BETA_M = 0.05  # before anything is learned
MAX_RESIDUAL_M = 1.0  # more is no noise
PIXELS = 8192  # evaluated at a time: what the layers pass on then stays in the cache


@dataclass(frozen=True)
class Residuals:
    """What a model learns from: how far readings lie beyond something (N,) metres, its inputs (N, F) there,
    and the scale `blur` (N,) metres of the error of that something, 0 if it is unknown."""

    metres: Tensor
    features: Tensor
    blur: Tensor

    @staticmethod
    def against_truth(metres: Tensor, features: Tensor) -> Residuals:
        """Residuals against something that is not known to err."""
        return Residuals(metres, features, torch.zeros_like(metres))

    def __len__(self) -> int:
        return len(self.metres)

    def to(self, device: torch.device) -> Residuals:
        """The residuals where a model is."""
        return Residuals(self.metres.to(device), self.features.to(device), self.blur.to(device))

    def joined(self, other: Residuals) -> Residuals:
        device = self.metres.device
        pairs = ((self.metres, other.metres), (self.features, other.features), (self.blur, other.blur))
        return Residuals(*(torch.cat([ours, theirs.to(device)]) for ours, theirs in pairs))


class PixelNetwork(nn.Module):
    """Two hidden layers from what is known of a pixel (N, F) to `outputs` numbers; learns by a Laplace likelihood."""

    def __init__(
        self, config: UncertaintyConfig, generator: torch.Generator, features: tuple[str, ...], outputs: int
    ) -> None:
        super().__init__()
        self.config = config
        sizes = [len(features), config.hidden, config.hidden, outputs]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        seen = input_mask(config.inputs) if features is FEATURES else torch.ones(len(features))
        self.register_buffer("seen", seen, persistent=False)
        with torch.no_grad():
            for layer in self.layers:
                bound = math.sqrt(6 / sum(layer.weight.shape))  # Xavier, as in METHOD.md section 3
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.zero_()
            self.layers[-1].weight.mul_(0.1)
            self.layers[-1].bias[0] = math.log(math.expm1(START_BETA_M))
        self.optimizer = Adam(self.parameters())

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.seen.device

    def scale_and_offset(self, features: Tensor) -> tuple[Tensor, Tensor | float]:
        """(N, F) -> Laplace scale (N,) and middle (N,) of what is to be expected, metres."""
        raise NotImplementedError

    def outputs(self, features: Tensor) -> Tensor:
        """(..., F) -> (..., outputs), of which the first is the scale before softplus."""
        first, *others = self.layers[:-1]
        hidden = torch.relu_(linear(features, first.weight * self.seen, first.bias))
        for layer in others:
            hidden = torch.relu_(layer(hidden))
        return self.layers[-1](hidden)

    def scale(self, outputs: Tensor) -> Tensor:
        return self.config.beta_min_m + softplus(outputs[..., 0])

    @torch.no_grad()
    def image(self, depth: Tensor, features: Tensor) -> Tensor:
        """depth (H, W) metres, features (H, W, F) -> what `forward` says (H, W), 0 where there is no reading."""
        parts = features.reshape(-1, features.shape[-1]).split(PIXELS)
        return torch.cat([self(part) for part in parts]).view(depth.shape) * (depth > 0)

    def learn(
        self, residuals: Residuals, steps: int, generator: torch.Generator, quantile_objective: bool = False
    ) -> float:
        """Minimise the negative log-likelihood of what was observed, or, `quantile_objective`, how badly it is covered.

        Returns the last mean likelihood, nats.
        """
        nats, loss_of = torch.zeros(()), interval_loss if quantile_objective else laplace_nll
        if len(residuals) == 0:
            return math.nan
        residuals = residuals.to(self.device)
        off = residuals.metres.clamp(-MAX_RESIDUAL_M, MAX_RESIDUAL_M)
        for step in range(steps):
            batch = torch.randint(len(residuals), (self.config.batch,), generator=generator).to(off.device)
            scale, offset = self.scale_and_offset(residuals.features[batch].float())
            misses = off[batch] - offset, torch.hypot(scale, residuals.blur[batch])
            loss = loss_of(*misses).mean()
            self.optimizer.zero_grad()
            loss.backward()
            self.optimizer.step(self.config.learning_rate * (1 - 0.9 * step / steps))
            nats = laplace_nll(*misses).detach().mean() if step + 1 == steps else nats
        return float(nats)

    def training_state(self) -> tuple[dict[str, Any], dict[int, dict[str, Any]]]:
        """Plain tensors and containers that `load_training_state` goes on learning from, bit for bit."""
        return self.state_dict(), self.optimizer.state_dict()

    def load_training_state(self, state: tuple[dict[str, Any], dict[int, dict[str, Any]]]) -> None:
        self.load_state_dict(state[0])
        self.optimizer.load_state_dict(state[1])


class NoiseModel(PixelNetwork):
    """h_w of one sensor: (N, F) features -> (N,) beta in metres, at least `beta_min_m` (paper: beta_min + softplus)."""

    def __init__(
        self, config: UncertaintyConfig, generator: torch.Generator, features: tuple[str, ...] = FEATURES
    ) -> None:
        super().__init__(config, generator, features, outputs=1)
        self.has_prior = False  # it starts from what another recording taught

    @property
    def taught(self) -> bool:
        """Whether it ever learned from residuals, here or in the recording of its prior."""
        return self.has_prior or bool(self.optimizer.moments)

    def forward(self, features: Tensor) -> Tensor:
        return self.scale(self.outputs(features))

    def scale_and_offset(self, features: Tensor) -> tuple[Tensor, Tensor | float]:
        return self(features), 0.0

    @torch.no_grad()
    def in_betas(self, residuals: Residuals) -> np.ndarray:
        """(N,) |residual| over beta."""
        return (residuals.metres.abs() / self(residuals.features.float())).cpu().numpy()

    def beta_image(self, depth: Tensor, features: Tensor) -> Tensor:
        """depth (H, W) metres, features (H, W, F) -> beta (H, W) metres, 0 where there is no reading."""
        return self.image(depth, features)


def input_mask(names: tuple[str, ...]) -> Tensor:
    """(F,) 1 for the inputs called `names` and 0 for the others; all 1 if there are no names. Raises ConfigError."""
    unknown = [name for name in names if name not in FEATURES]
    if unknown:
        known = ", ".join(FEATURES)
        raise ConfigError(f"setting uncertainty.inputs: no input is called {unknown[0]!r}; known inputs: {known}")
    return torch.tensor([float(not names or name in names) for name in FEATURES])
