"""Is the sigma of a vertex right? It predicts the 1-sigma distance to the true surface, in metres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ..core.errors import DataError
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from ..sensors.error_quantiles import LEVELS
from .uncertainty_calibration import BINS, rank_correlation, sparsification

MEDIAN_IN_SIGMAS = float(norm.ppf(0.75))  # 0.674, of the distance |e| of a Gaussian error
SIGMAS = (1.0, 2.0)


@dataclass(frozen=True)
class ConfidenceCurves:
    """Data for plots.

    nominal, empirical               stated share of vertices within a multiple of sigma, and the share found
    bin_sigma_m, bin_distance_rms_m  mean sigma and root mean square distance in bins of equal size, by rising sigma
    """

    nominal: tuple[float, ...]
    empirical: tuple[float, ...]
    bin_sigma_m: tuple[float, ...]
    bin_distance_rms_m: tuple[float, ...]


@dataclass(frozen=True)
class VertexSigmaMetrics:
    """Scores of the sigma of vertices against their distance d >= 0 to the true surface.

    d is |e| of an error e along the normal, so a Gaussian e leaves 68.3 % of the vertices within 1 sigma and 95.4 %
    within 2, and a median of d / sigma of `MEDIAN_IN_SIGMAS`.

    coverage_1_sigma, _2_sigma   share of vertices with d <= sigma, d <= 2 sigma
    median_in_sigmas             median of d / sigma
    sigma_factor                 what sigma has to be multiplied by for that to be right: 1 is right, more is rash
    rank_correlation             Spearman's, of sigma and d; None if one of them is constant
    ause, ause_random            area between the sparsification curves of sigma, or of any order, and the oracle's
    """

    coverage_1_sigma: float
    coverage_2_sigma: float
    median_in_sigmas: float
    sigma_factor: float
    rank_correlation: float | None
    ause: float
    ause_random: float
    median_distance_m: float
    median_sigma_m: float
    vertices: int
    curves: ConfidenceCurves


def evaluate_vertex_sigma(
    mesh: Mesh, reference: Mesh, visible: Callable[[np.ndarray], np.ndarray] | None = None
) -> VertexSigmaMetrics:
    """Score the sigma of vertices of `mesh`, in the frame of `reference`; with `visible` only of those it keeps.

    Raises DataError if the mesh has no sigma or no vertex that can be scored, or one is not positive.
    """
    if mesh.sigma is None:
        raise DataError("the vertices of the mesh have no sigma")
    keep = np.isin(np.arange(len(mesh.vertices)), mesh.faces)
    if visible is not None and keep.any():
        keep[keep] = visible(mesh.vertices[keep])
    if not keep.any():
        raise DataError("the mesh has no vertex whose sigma can be scored")
    return score_vertex_sigma(Surface(reference).distance(mesh.vertices[keep]), mesh.sigma[keep])


def score_vertex_sigma(distance_m: np.ndarray, sigma_m: np.ndarray) -> VertexSigmaMetrics:
    """Score `sigma_m` (N,) > 0 against `distance_m` (N,) >= 0, metres. Raises DataError if a value breaks that."""
    distance, sigma = distance_m.astype(np.float64), sigma_m.astype(np.float64)
    if not (np.isfinite(distance).all() and np.isfinite(sigma).all() and (sigma > 0).all()):
        raise DataError("the sigma of every vertex must be a positive length, and the reference not empty")
    order = np.random.default_rng(0).permutation(len(sigma))  # breaks ties of sigma fairly
    distance, sigma = distance[order], sigma[order]
    ratio = distance / sigma
    removed, by_sigma, oracle = sparsification(distance, sigma)
    return VertexSigmaMetrics(
        *(float(np.mean(ratio <= count)) for count in SIGMAS),
        float(np.median(ratio)),
        float(np.median(ratio)) / MEDIAN_IN_SIGMAS,
        rank_correlation(sigma, distance),
        float(np.trapezoid(by_sigma - oracle, removed)),
        float(np.trapezoid(1.0 - oracle, removed)),
        float(np.median(distance)),
        float(np.median(sigma)),
        len(sigma),
        _curves(distance, sigma),
    )


def _curves(distance: np.ndarray, sigma: np.ndarray) -> ConfidenceCurves:
    bins = np.array_split(np.argsort(sigma, kind="stable"), min(BINS, len(sigma)))
    return ConfidenceCurves(
        LEVELS,
        tuple(float(np.mean(distance <= sigma * norm.ppf((1 + level) / 2))) for level in LEVELS),
        tuple(float(sigma[chosen].mean()) for chosen in bins),
        tuple(float(np.sqrt(np.square(distance[chosen]).mean())) for chosen in bins),
    )
