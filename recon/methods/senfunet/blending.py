"""How the maps of two sensors become one, given the share alpha of the first in each sample."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor


def weighting_inputs(features: tuple[Tensor, Tensor], weights: tuple[Tensor, Tensor]) -> Tensor:
    """Features (N, X, Y, Z, 4) and weights (N, X, Y, Z) of two sensors -> (N, 10, X, Y, Z) for `WeightingNetwork`."""
    parts = [part for f, w in zip(features, weights, strict=True) for part in (f, torch.tanh(w)[..., None])]
    return torch.cat(parts, -1).movedim(-1, 1)


def fused_distance(alpha: Tensor, first: Tensor, second: Tensor, weight_1: Tensor, weight_2: Tensor) -> Tensor:
    """alpha * first + (1 - alpha) * second where both sensors read something, else that of the one that did."""
    share = torch.where(weight_2 == 0, 1.0, torch.where(weight_1 == 0, 0.0, alpha))
    return share * first + (1 - share) * second


def believed(alpha: Tensor, weight_1: Tensor, weight_2: Tensor) -> Tensor:
    """The outlier filter: what one sensor alone says is kept where its own share is more than half."""
    return torch.where(weight_2 == 0, alpha > 0.5, torch.where(weight_1 == 0, alpha < 0.5, True))


def single_sensor(weight_1: Tensor, weight_2: Tensor) -> Iterator[Tensor]:
    """Masks of the samples that only the first, and only the second sensor read."""
    yield (weight_1 > 0) & (weight_2 == 0)
    yield (weight_2 > 0) & (weight_1 == 0)
