"""How many betas the central intervals of a sensor's errors are wide: errors are seldom Laplace, and flatter as a rule.

One number per level and sensor, found without truth: the quantiles of |residual| / beta of its readings against the
finished map. They keep their promise as far as the residuals have the shape of the errors.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

LEVELS = tuple(round(0.05 * step, 2) for step in range(1, 20))  # 5 to 95 %
MIN_MEASUREMENTS = 200
ErrorQuantiles = Mapping[str, float]  # per cent, "5" to "95" -> half the width in betas


def fit_error_quantiles(off_in_betas: np.ndarray) -> dict[str, float]:
    """From |residual| / beta (N,); nothing if they are too few."""
    if len(off_in_betas) < MIN_MEASUREMENTS:
        return {}
    widths = np.quantile(off_in_betas, LEVELS)
    return {key_of(level): round(float(width), 3) for level, width in zip(LEVELS, widths, strict=True)}


def key_of(level: float) -> str:
    return f"{100 * level:.0f}"
