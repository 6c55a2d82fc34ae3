"""The Cauchy kernel of robust least squares."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

Array = TypeVar("Array", np.ndarray, Tensor)


def cauchy(ratio: Array) -> tuple[Array, Array]:
    """Cost and influence of residuals r under the Cauchy kernel of scale s, rho(r) = s^2 log(1 + r^2 / s^2).

    `ratio` (...) is (r / s)^2. Returns rho / s^2, and the divisor 1 + ratio: the weight of a residual in the normal
    equations is one over it. A divisor, so that the caller can divide a product that already holds other factors.
    """
    if isinstance(ratio, Tensor):
        return torch.log1p(ratio), 1 + ratio
    return np.log1p(ratio), 1 + ratio
