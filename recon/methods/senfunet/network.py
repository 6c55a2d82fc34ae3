"""The two networks of SenFuNet: features of an image, and the share of the first sensor in a sample of the map."""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import normalize

FEATURES = 4  # of a pixel: three learned ones of unit length, and its depth
HALO = 2  # samples around a block that the weighting looks at
PARAMETERS = 22_529
_LEARNED = 3
_BLOCKS = 6


class FeatureNetwork(nn.Module):
    """An image of a sensor -> (N, 4, H, W): three features of length 1, and the depth itself.

    Six residual blocks of two 3 x 3 convolutions with tanh, three channels wide. Input: depth (N, 1, H, W) metres, with
    `color` also (N, 3, H, W) in 0..1. The first block changes the number of channels: a 1 x 1 convolution around it.
    """

    def __init__(self, color: bool, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.color = color
        widths = [4 if color else 1, *[_LEARNED] * _BLOCKS]
        self.blocks = nn.ModuleList(_ResidualBlock(a, b) for a, b in pairwise(widths))
        _start(self, generator)

    def forward(self, depth: Tensor, color: Tensor | None = None) -> Tensor:
        """Depth (N, 1, H, W) metres, color (N, 3, H, W) in 0..1 or None -> (N, 4, H, W).

        Raises ValueError if a network with colour gets none.
        """
        values = depth
        if self.color:
            if color is None:
                raise ValueError("this network needs a colour image beside the depth")
            values = torch.cat([depth, color], 1)
        for block in self.blocks:
            values = block(values)
        return torch.cat([normalize(values, dim=1, eps=1e-6), depth], 1)


class WeightingNetwork(nn.Module):
    """Features and tanh(weight) of both sensors (N, 10, X + 4, Y + 4, Z + 4) -> alpha (N, X, Y, Z) of the first, 0..1.

    The caller gives `HALO` samples around, where the reference repeats the outermost ones of its chunks.
    """

    def __init__(self, generator: torch.Generator | None = None) -> None:
        super().__init__()
        self.layers = nn.Sequential(
            nn.Conv3d(2 * (FEATURES + 1), 32, 3), nn.ReLU(), nn.Conv3d(32, 16, 3), nn.ReLU(), nn.Conv3d(16, 1, 1)
        )
        _start(self, generator)
        assert sum(values.numel() for values in self.parameters()) == PARAMETERS

    def forward(self, samples: Tensor) -> Tensor:
        """Samples (N, 10, X + 4, Y + 4, Z + 4) -> alpha (N, X, Y, Z) in 0..1."""
        return torch.sigmoid(self.layers(samples))[:, 0]


class _ResidualBlock(nn.Module):
    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, padding=1, padding_mode="replicate")
        self.second = nn.Conv2d(outputs, outputs, 3, padding=1, padding_mode="replicate")
        self.around = nn.Identity() if inputs == outputs else nn.Conv2d(inputs, outputs, 1)

    def forward(self, values: Tensor) -> Tensor:
        return self.around(values) + torch.tanh(self.second(torch.tanh(self.first(values))))


def _start(module: nn.Module, generator: torch.Generator | None) -> None:
    """PyTorch's own initial values (uniform, bound 1 / sqrt(inputs)), from `generator`."""
    if generator is None:
        return
    with torch.no_grad():
        for layer in module.modules():
            if isinstance(layer, nn.Conv2d | nn.Conv3d):
                bound = layer.weight[0].numel() ** -0.5
                for values in layer.parameters():  # weight, bias
                    values.uniform_(-bound, bound, generator=generator)
