"""Frames whose camera is far from all others: most often a wrong pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

MIN_GAP_M = 20.0  # farther than two depth cameras can see the same thing from
MIN_GAP_STEPS = 20.0  # and than so many usual distances to the nearest camera: few frames over a long way
_CELLS = 4  # cells in a gap


@dataclass(frozen=True)
class FarFrames:
    """Positions, in the list of all, of cameras that are close together, and their distance to the nearest other."""

    indices: tuple[int, ...]
    distance_m: float


def far_frames(positions: np.ndarray) -> list[FarFrames]:
    """Groups of cameras (N, 3), metres, that a gap separates from the largest group, in order.

    Two cameras are of one group if a chain of cameras joins them, in which each is nearer to the next than the gap:
    `MIN_GAP_M`, or `MIN_GAP_STEPS` times the median distance to the nearest camera.
    """
    if len(positions) < 2:
        return []
    labels = _groups(positions, _gap(positions))
    largest = np.bincount(labels).argmax()
    others = cKDTree(positions[labels == largest])
    groups = []
    for label in dict.fromkeys(labels[labels != largest].tolist()):
        indices = np.flatnonzero(labels == label)
        distance = float(np.min(others.query(positions[indices])[0]))
        groups.append(FarFrames(tuple(indices.tolist()), distance))
    return groups


def describe_far_frames(groups: Sequence[FarFrames], numbers: Sequence[int]) -> str:
    """One line that names at most three groups, by the number of each frame; empty if there are none."""
    if not groups:
        return ""
    parts = []
    for group in groups[:3]:
        first, last = numbers[group.indices[0]], numbers[group.indices[-1]]
        few = f"frame {first}" if len(group.indices) == 1 else f"{len(group.indices)} frames from {first} to {last}"
        parts.append(f"{few}: {_kilometres(group.distance_m)}")
    more = f" and {len(groups) - 3} more groups" if len(groups) > 3 else ""
    return f"far from all other frames, perhaps by a wrong pose: {'; '.join(parts)}{more}"


def _gap(positions: np.ndarray) -> float:
    nearest = np.asarray(cKDTree(positions).query(positions, k=2)[0])[:, 1]
    return max(MIN_GAP_M, MIN_GAP_STEPS * float(np.median(nearest)))


def _groups(positions: np.ndarray, gap_m: float) -> np.ndarray:
    """(N,) labels. Cameras are joined by cells of a quarter of the gap, so that many in one place cost nothing."""
    cells, cell_of = np.unique(np.floor(positions * (_CELLS / gap_m)), axis=0, return_inverse=True)
    pairs = cKDTree(cells).query_pairs(_CELLS, output_type="ndarray")
    graph = coo_matrix((np.ones(len(pairs), bool), pairs.T), shape=(len(cells),) * 2)
    labels: np.ndarray = connected_components(graph, directed=False)[1][cell_of.reshape(-1)]
    return labels


def _kilometres(metres: float) -> str:
    return f"{metres:.0f} m" if metres < 10_000 else f"{metres / 1000:.0f} km"
