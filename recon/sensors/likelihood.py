"""Losses of a predicted error scale: pure functions of residuals and scales."""

from __future__ import annotations

import math

import torch
from torch import Tensor

QUANTILE_LEVELS = (0.5, 0.9)  # of the central intervals whose coverage the quantile loss balances
MIN_ERROR_M = 1e-4  # smaller errors count as this: their logarithm would diverge


def laplace_nll(residual: Tensor, beta: Tensor) -> Tensor:
    """Negative log-likelihood |r| / beta + log(2 beta) of residuals (...), metres, under a Laplace distribution.

    The mapping loss of UncLe-SLAM (docs/uncle-paper.md) plus log 2, which makes the value a true likelihood. Minimal at
    beta = |r|.
    """
    return residual.abs() / beta + torch.log(2 * beta)


def quantile_loss(residual: Tensor, beta: Tensor) -> Tensor:
    """How far the central Laplace intervals of beta are from covering residuals (...), metres, as often as they should.

    The sum of the pinball losses of log |r| at the `QUANTILE_LEVELS` (Koenker and Bassett 1978: quantile regression).
    Errors need not be Laplace; then no scale fits both levels, and the minimum misses them by the same amount. By the
    logarithm every measurement counts alike, whatever its scale.
    """
    log_error = torch.log(residual.abs().clamp(min=MIN_ERROR_M))
    total = torch.zeros_like(log_error)
    for level in QUANTILE_LEVELS:
        excess = log_error - torch.log(-math.log(1 - level) * beta)
        total = total + torch.maximum(level * excess, (level - 1) * excess)
    return total
