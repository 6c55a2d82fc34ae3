"""The result of localising a frame, and the residual to the surface that a pose must have to be believed."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

MAX_RESIDUAL_RATIO = 2.5  # to the usual residual
_RATE = 0.1  # how fast the usual residual follows


@dataclass(frozen=True)
class Localisation:
    """A pose (4, 4), its information (6, 6) from what was seen, the matched features (K,) and their landmarks (K,).

    shown (6, 6): the share of a motion that the frame shows rather than the expectation.
    """

    pose: np.ndarray
    information: np.ndarray
    rows: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    numbers: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int64))
    shown: np.ndarray = field(default_factory=lambda: np.eye(6))


class UsualResidual:
    """Running mean of the residuals to the surface, in sigmas; None before the first."""

    def __init__(self) -> None:
        self.mean: float | None = None

    def accepts(self, residual: float) -> bool:
        """Whether a residual is about as small as usual; if so, the mean follows."""
        usual = residual if self.mean is None else self.mean
        if residual > MAX_RESIDUAL_RATIO * usual:
            return False
        self.mean = usual + _RATE * (residual - usual)
        return True
