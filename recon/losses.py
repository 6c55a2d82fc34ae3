"""Likelihoods: pure functions of residuals and scales."""

from __future__ import annotations

import torch
from torch import Tensor


def laplace_nll(residual: Tensor, beta: Tensor) -> Tensor:
    """Negative log-likelihood |r| / beta + log(2 beta) of each residual (...), metres, under a Laplace law.

    Paper: mapping loss; the log 2 that it leaves out only makes the figure a true likelihood. Minimal at beta = |r|.
    """
    return residual.abs() / beta + torch.log(2 * beta)
