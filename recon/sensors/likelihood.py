"""Likelihoods: pure functions of residuals and scales."""

from __future__ import annotations

import math

import torch
from torch import Tensor

LEVELS = (0.5, 0.9)  # of the central intervals that are to be kept
LEAST_M = 1e-4  # what is nearer is as good as met


def laplace_nll(residual: Tensor, beta: Tensor) -> Tensor:
    """Negative log-likelihood |r| / beta + log(2 beta) of each residual (...), metres, under a Laplace law.

    Paper: mapping loss; the log 2 that it leaves out only makes the figure a true likelihood. Minimal at beta = |r|.
    """
    return residual.abs() / beta + torch.log(2 * beta)


def interval_loss(residual: Tensor, beta: Tensor) -> Tensor:
    """How badly the central Laplace intervals of beta cover each residual (...), metres: pinball losses of log |r| at
    the `LEVELS`, whose sum is minimal where the intervals of both, on average, cover as much as they say.

    Errors need not be Laplace; then one scale cannot serve both levels, and this misses them by equally much.
    Logarithms let each reading count alike, whatever its scale (Koenker and Bassett 1978: quantile regression).
    """
    off = torch.log(residual.abs().clamp(min=LEAST_M))
    total = torch.zeros_like(off)
    for level in LEVELS:
        beyond = off - torch.log(-math.log(1 - level) * beta)
        total = total + torch.maximum(level * beyond, (level - 1) * beyond)
    return total
