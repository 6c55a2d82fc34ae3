"""One integer for each row of integer coordinates, to find equal rows by one sort."""

from __future__ import annotations

import numpy as np


def row_keys(rows: np.ndarray) -> np.ndarray:
    """(N, 3) int64 -> (N,) int64: equal for equal rows, and in their lexicographic order.

    Also where the range of the coordinates, multiplied, exceeds 64 bits: places at a distance of many kilometres.
    """
    if not len(rows):
        return np.zeros(0, np.int64)
    rows = rows - rows.min(0)
    if np.prod(rows.max(0) + 1.0) >= np.iinfo(np.int64).max:  # ranks in place of the coordinates, in two steps
        rows = np.stack([np.unique(column, return_inverse=True)[1] for column in rows.T], 1)
        pairs = np.unique(rows[:, 0] * len(rows) + rows[:, 1], return_inverse=True)[1]
        return np.asarray(pairs * len(rows) + rows[:, 2], np.int64)
    span = rows.max(0) + 1
    return np.asarray((rows[:, 0] * span[1] + rows[:, 1]) * span[2] + rows[:, 2], np.int64)
