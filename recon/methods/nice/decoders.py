"""The decoders of the feature grids: middle and fine occupancy, colour (docs/uncle-paper.md, Scene representation)."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

# Constants of NICE-SLAM.
CHANNELS = 32  # of every feature grid
EMBEDDING = 93  # frequencies of the positional embedding
EMBEDDING_SCALE = 25.0  # their standard deviation, radians per metre
WIDTH = 32  # of the hidden layers
LAYERS = 5
SKIP_AFTER = 2  # the embedding is concatenated in front of the output of this hidden layer
OCCUPANCY_SLOPE = 10.0  # occupancy = sigmoid(slope * logit), at render time only


class Decoder(nn.Module):
    """A network from a position and the features there to a logit of occupancy, or to colour.

    With e = sin(p B): five times h <- relu(W h + b) + (V c + u), starting from h = e; [e, h] after the third.
    """

    def __init__(self, features: int, outputs: int = 1, *, generator: torch.Generator | None = None) -> None:
        """Random weights: B ~ N(0, 25^2), W Xavier-uniform (gain of the ReLU; 1 at the output), V PyTorch's default.

        features: length of c. outputs: 1 for occupancy, 4 for colour. generator: on the CPU; None: the global one.
        """
        super().__init__()
        self.features, self.outputs = features, outputs
        self.embedding = nn.Parameter(torch.empty(3, EMBEDDING))
        inputs = [EMBEDDING, *(WIDTH + EMBEDDING * (layer == SKIP_AFTER + 1) for layer in range(1, LAYERS))]
        self.hidden = nn.ModuleList(nn.Linear(size, WIDTH) for size in inputs)
        self.injection = nn.ModuleList(nn.Linear(features, WIDTH) for _ in range(LAYERS))
        self.output = nn.Linear(WIDTH, outputs)
        self._initialise(generator)

    @torch.no_grad()
    def _initialise(self, generator: torch.Generator | None) -> None:
        self.embedding.normal_(0.0, EMBEDDING_SCALE, generator=generator)
        for layer, gain in [*((layer, math.sqrt(2.0)) for layer in linear_layers(self.hidden)), (self.output, 1.0)]:
            nn.init.xavier_uniform_(layer.weight, gain, generator=generator)
            layer.bias.zero_()
        bound = 1.0 / math.sqrt(self.features)
        for layer in linear_layers(self.injection):
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.uniform_(-bound, bound, generator=generator)

    def forward(self, points: Tensor, features: Tensor) -> Tensor:
        """Logits of occupancy, or colour, (N, outputs), at points (N, 3), world, metres, with features (N, C)."""
        embedded = torch.sin(points @ self.embedding)
        state = embedded
        for layer, (hidden, injection) in enumerate(zip(self.hidden, self.injection, strict=True)):
            state = torch.relu(hidden(state)) + injection(features)
            if layer == SKIP_AFTER:
                state = torch.cat([embedded, state], dim=-1)
        return self.output(state)


def linear_layers(layers: nn.ModuleList) -> list[nn.Linear]:
    """The linear layers among `layers`, in their order."""
    return [layer for layer in layers if isinstance(layer, nn.Linear)]


def middle_decoder(generator: torch.Generator | None = None) -> Decoder:
    """Coarse occupancy from the middle grid: 15 800 parameters."""
    return Decoder(CHANNELS, generator=generator)


def fine_decoder(generator: torch.Generator | None = None) -> Decoder:
    """Residual of the middle logit from [fine, middle] features: 20 920 parameters."""
    return Decoder(2 * CHANNELS, generator=generator)


def color_decoder(generator: torch.Generator | None = None) -> Decoder:
    """Colour from the colour grid: 15 899 parameters; of its four outputs the first three are red, green and blue."""
    return Decoder(CHANNELS, 4, generator=generator)


@dataclass(frozen=True)
class OccupancyDecoders:
    """The middle and the fine decoder, and the origin of their weights."""

    middle: Decoder
    fine: Decoder
    origin: str = "random weights"
    recipe: dict[str, Any] = field(default_factory=dict)  # settings, versions and scores of the training

    def frozen(self, device: torch.device | str = "cpu") -> OccupancyDecoders:
        """Move the networks to `device`, without gradients of their weights; returns self."""
        for decoder in (self.middle, self.fine):
            decoder.to(device).requires_grad_(False)
        return self

    @property
    def digest(self) -> str:
        """Short hash of the weights."""
        content = hashlib.sha256()
        for decoder in (self.middle, self.fine):
            for values in decoder.state_dict().values():
                content.update(values.cpu().contiguous().numpy().tobytes())
        return content.hexdigest()[:16]

    def logits(self, points: Tensor, middle: Tensor, fine: Tensor | None = None) -> Tensor:
        """Logit of occupancy, (N,): middle(p), or middle(p) + fine(p) where fine features are given.

        points (N, 3) metres; middle, fine (N, 32). No gradient reaches the middle features through the fine decoder.
        """
        coarse = self.middle(points, middle)[:, 0]
        if fine is None:
            return coarse
        return coarse + self.fine(points, torch.cat([fine, middle.detach()], dim=-1))[:, 0]


def random_decoders(seed: int) -> OccupancyDecoders:
    """Untrained decoders: the start of a training, or for tests."""
    generator = torch.Generator().manual_seed(seed)
    return OccupancyDecoders(middle_decoder(generator), fine_decoder(generator), f"random weights, seed {seed}")
