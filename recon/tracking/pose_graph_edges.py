"""Measured motions between pairs of frames, as terms of a bundle adjustment or a pose graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..core.se3 import adjoint, inverse, motion_between

Measured = tuple[int, int, np.ndarray, np.ndarray]  # two frames, T_first_second (4, 4), information (6, 6)

ROBUST_SCALE = 10.0  # sigmas of a whole motion; beyond, an edge loses influence (Cauchy)


@dataclass(frozen=True)
class PoseEdges:
    """first, second (E,) cameras; T_first_second (E, 4, 4) as measured; information (E, 6, 6) by the motion of the
    second."""

    first: np.ndarray
    second: np.ndarray
    T_first_second: np.ndarray
    information: np.ndarray

    def __len__(self) -> int:
        return len(self.first)


@dataclass(frozen=True)
class LinearisedEdges:
    """cost; diagonal blocks U (C, 6, 6) and gradient g (C, 6) to add; `across` (E, 6, 6) between first and second."""

    cost: float
    U: np.ndarray
    g: np.ndarray
    across: np.ndarray


def edges_among(measured: Sequence[Measured], positions: Sequence[int]) -> PoseEdges | None:
    """What was measured between frames of `positions`, by their places in it; None if nothing was."""
    place = {p: i for i, p in enumerate(positions)}
    inside = [edge for edge in measured if edge[0] in place and edge[1] in place]
    if not inside:
        return None
    first, second, motions, information = zip(*inside, strict=True)
    return PoseEdges(
        np.array([place[p] for p in first]), np.array([place[p] for p in second]), np.stack(motions),
        np.stack(information),
    )  # fmt: skip


def linearise_edges(poses: np.ndarray, edges: PoseEdges) -> LinearisedEdges:
    """The edges' part of the normal equations at poses (C, 4, 4)."""
    between = inverse(poses[edges.first]) @ poses[edges.second]
    off = motion_between(edges.T_first_second, between)
    J_first = -adjoint(inverse(between))  # a motion of the first is, seen from the second, its opposite
    squared = np.einsum("ei,eij,ej->e", off, edges.information, off)
    ratio = squared / (6 * ROBUST_SCALE**2)
    cost = float(6 * ROBUST_SCALE**2 * np.log1p(ratio).sum())
    weighted = edges.information / (1 + ratio)[:, None, None]
    pull = (weighted @ off[..., None])[..., 0]
    transposed = np.swapaxes(J_first, 1, 2)
    U, g = np.zeros((len(poses), 6, 6)), np.zeros((len(poses), 6))
    np.add.at(U, edges.second, weighted)
    np.add.at(U, edges.first, transposed @ weighted @ J_first)
    np.add.at(g, edges.second, pull)
    np.add.at(g, edges.first, (transposed @ pull[..., None])[..., 0])
    return LinearisedEdges(cost, U, g, transposed @ weighted)
