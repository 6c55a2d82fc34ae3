"""Quantiles of a sensor's errors in units of beta: calibrated intervals, since errors are seldom exactly Laplace.

One number per level and sensor, without ground truth: the quantiles of |residual| / beta of its measurements against
the finished map. The intervals are right as far as these residuals are distributed as the errors are.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

LEVELS = tuple(round(0.05 * step, 2) for step in range(1, 20))  # 5 to 95 %
MIN_MEASUREMENTS = 200
ErrorQuantiles = Mapping[str, float]  # level in per cent, "5" to "95" -> half width of the central interval, in betas


def fit_error_quantiles(normalised: np.ndarray) -> dict[str, float]:
    """Quantiles of |residual| / beta (N,) at the `LEVELS`; an empty dictionary if there are too few."""
    if len(normalised) < MIN_MEASUREMENTS:
        return {}
    widths = np.quantile(normalised, LEVELS)
    return {level_key(level): round(float(width), 3) for level, width in zip(LEVELS, widths, strict=True)}


def level_key(level: float) -> str:
    """The key of a level in `ErrorQuantiles`: 0.5 -> "50"."""
    return f"{100 * level:.0f}"
