"""The noise model h_w of a sensor: a small network from inputs of a pixel to the Laplace scale beta of its depth."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
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
from .likelihood import laplace_nll, quantile_loss
from .noise_inputs import SENSOR_INPUTS

START_BETA_M = 0.05
PIXELS = 8192  # evaluated at a time: the activations of the layers then stay in the cache


@dataclass(frozen=True)
class NoiseModelParameters:
    """Constants of the network and its training.

    start_beta_m       beta of every pixel before anything is learned
    max_residual_m     larger residuals count as this: they are no noise
    output_gain        factor on the initial weights of the last layer, so that the start depends little on the pixel
    final_rate_ratio   the step size falls linearly to this fraction during `learn`
    """

    start_beta_m: float = START_BETA_M
    max_residual_m: float = 1.0
    output_gain: float = 0.1
    final_rate_ratio: float = 0.1


PARAMETERS = NoiseModelParameters()


@dataclass(frozen=True)
class Residuals:
    """What a model is trained on: N measurements compared with a reference, such as the map.

    metres            (N,) measured minus reference depth
    inputs            (N, F) inputs of the network at the pixels
    reference_scale   (N,) Laplace scale of the reference's own error, metres; 0 if it is unknown
    """

    metres: Tensor
    inputs: Tensor
    reference_scale: Tensor

    @staticmethod
    def from_exact_reference(metres: Tensor, inputs: Tensor) -> Residuals:
        """Residuals (N,) metres with noise inputs (N, F) against a reference whose own error is taken to be 0."""
        return Residuals(metres, inputs, torch.zeros_like(metres))

    def __len__(self) -> int:
        return len(self.metres)

    def to(self, device: torch.device) -> Residuals:
        """The same on another device."""
        return Residuals(self.metres.to(device), self.inputs.to(device), self.reference_scale.to(device))

    def concatenate(self, other: Residuals) -> Residuals:
        """These followed by `other`, on the device of these."""
        other = other.to(self.metres.device)
        return Residuals(
            torch.cat([self.metres, other.metres]),
            torch.cat([self.inputs, other.inputs]),
            torch.cat([self.reference_scale, other.reference_scale]),
        )


class PixelNetwork(nn.Module, ABC):
    """Two hidden layers from the inputs of a pixel (N, F) to `outputs` numbers, trained by a Laplace likelihood.

    `input_names` are those of the F columns; `used_inputs` those of them that the network sees, all if empty.
    `is_trained`: whether it was ever trained, also before it was saved or used as a prior.
    """

    input_mask: Tensor

    def __init__(
        self,
        config: UncertaintyConfig,
        generator: torch.Generator,
        input_names: tuple[str, ...],
        outputs: int,
        used_inputs: tuple[str, ...] = (),
        parameters: NoiseModelParameters = PARAMETERS,
    ) -> None:
        super().__init__()
        self.config, self.input_names, self.constants = config, input_names, parameters
        self.is_trained = False
        sizes = [len(input_names), config.hidden, config.hidden, outputs]
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))
        self.register_buffer("input_mask", input_mask(input_names, used_inputs), persistent=False)
        with torch.no_grad():
            for layer in self._linear_layers():
                bound = math.sqrt(6 / sum(layer.weight.shape))  # Glorot and Bengio 2010, uniform
                layer.weight.uniform_(-bound, bound, generator=generator)
                layer.bias.zero_()
            last = self._linear_layers()[-1]
            last.weight.mul_(parameters.output_gain)
            last.bias[0] = math.log(math.expm1(parameters.start_beta_m))
        self.optimizer = Adam(self.parameters())

    @property
    def device(self) -> torch.device:
        """Where its weights are."""
        return self.input_mask.device

    @property
    def used_inputs(self) -> list[str]:
        """Names of the inputs that it sees."""
        return [name for name, used in zip(self.input_names, self.input_mask.tolist(), strict=True) if used]

    @abstractmethod
    def scale_and_offset(self, inputs: Tensor) -> tuple[Tensor, Tensor | float]:
        """(N, F) -> Laplace scale (N,) and centre (N,) of the residual's distribution, metres."""

    def outputs(self, inputs: Tensor) -> Tensor:
        """(..., F) -> (..., outputs), of which the first is the scale before softplus."""
        first, *others, last = self._linear_layers()
        hidden = torch.relu_(linear(inputs, first.weight * self.input_mask, first.bias))
        for layer in others:
            hidden = torch.relu_(layer(hidden))
        result: Tensor = last(hidden)
        return result

    def scale(self, outputs: Tensor) -> Tensor:
        """(..., outputs) -> (...) Laplace scale, metres: beta_min + softplus, as in UncLe-SLAM."""
        return self.config.beta_min_m + softplus(outputs[..., 0])

    @torch.no_grad()
    def image(self, depth: Tensor, inputs: Tensor) -> Tensor:
        """depth (H, W) metres, inputs (H, W, F) -> `forward` of each pixel (H, W), 0 where there is no measurement."""
        parts = inputs.reshape(-1, inputs.shape[-1]).split(PIXELS)
        return torch.cat([self(part) for part in parts]).view(depth.shape) * (depth > 0)

    def learn(
        self, residuals: Residuals, steps: int, generator: torch.Generator, quantile_objective: bool = False
    ) -> float:
        """Train on random batches: minimise the negative log-likelihood, or, `quantile_objective`, the quantile loss.

        Returns the mean negative log-likelihood of the last batch, nats; NaN if there are no residuals.
        """
        nats, loss_of = torch.zeros(()), quantile_loss if quantile_objective else laplace_nll
        if len(residuals) == 0:
            return math.nan
        residuals = residuals.to(self.device)
        limit_m = self.constants.max_residual_m
        fall = 1 - self.constants.final_rate_ratio
        metres = residuals.metres.clamp(-limit_m, limit_m)
        for step in range(steps):
            batch = torch.randint(len(residuals), (self.config.batch,), generator=generator).to(metres.device)
            scale, offset = self.scale_and_offset(residuals.inputs[batch].float())
            error, total_scale = metres[batch] - offset, torch.hypot(scale, residuals.reference_scale[batch])
            loss = loss_of(error, total_scale).mean()
            self.optimizer.zero_grad()
            loss.backward()
            self.optimizer.step(self.config.learning_rate * (1 - fall * step / steps))
            self.is_trained = True
            nats = laplace_nll(error, total_scale).detach().mean() if step + 1 == steps else nats
        return float(nats)

    def training_state(self) -> dict[str, Any]:
        """Plain tensors and containers from which `load_training_state` continues training, bit for bit."""
        return {"weights": self.state_dict(), "moments": self.optimizer.state_dict(), "is_trained": self.is_trained}

    def load_training_state(self, state: Mapping[str, Any]) -> None:
        """Continue from what `training_state` returned."""
        self.load_state_dict(state["weights"])
        self.optimizer.load_state_dict(state["moments"])
        self.is_trained = state["is_trained"]

    def _linear_layers(self) -> list[nn.Linear]:
        return [layer for layer in self.layers if isinstance(layer, nn.Linear)]


class NoiseModel(PixelNetwork):
    """h_w: (N, F) inputs -> (N,) beta, metres, at least `beta_min_m`.

    Without `input_names` it is the model of a depth sensor, which sees those of the `SENSOR_INPUTS` that the settings
    name; with them it sees all of them.
    """

    def __init__(
        self, config: UncertaintyConfig, generator: torch.Generator, input_names: tuple[str, ...] | None = None
    ) -> None:
        if input_names is None:
            super().__init__(config, generator, SENSOR_INPUTS, 1, used_inputs=config.inputs)
        else:
            super().__init__(config, generator, input_names, 1)

    def forward(self, inputs: Tensor) -> Tensor:
        """(..., F) -> (...) beta, metres."""
        return self.scale(self.outputs(inputs))

    def scale_and_offset(self, inputs: Tensor) -> tuple[Tensor, Tensor | float]:
        """(N, F) -> beta (N,), and 0: the errors are taken to be unbiased."""
        return self.forward(inputs), 0.0

    @torch.no_grad()
    def normalised(self, residuals: Residuals) -> np.ndarray:
        """(N,) |residual| / beta."""
        return (residuals.metres.abs() / self.forward(residuals.inputs.float())).cpu().numpy()

    def beta_image(self, depth: Tensor, inputs: Tensor) -> Tensor:
        """depth (H, W) metres, inputs (H, W, F) -> beta (H, W) metres, 0 where there is no measurement."""
        return self.image(depth, inputs)

    def initialise_from_prior(self, weights: Mapping[str, Tensor]) -> None:
        """Start from the weights of a model of another recording. Raises RuntimeError if their shapes differ."""
        self.load_state_dict(weights)
        self.is_trained = True


def input_mask(names: tuple[str, ...], used: tuple[str, ...]) -> Tensor:
    """(F,) 1 for the inputs of `names` that are `used`, else 0; all 1 if `used` is empty. Raises ConfigError."""
    unknown = [name for name in used if name not in names]
    if unknown:
        raise ConfigError(
            f"setting uncertainty.inputs: no input is called {unknown[0]!r}; known inputs: {', '.join(names)}"
        )
    return torch.tensor([float(not used or name in used) for name in names])
