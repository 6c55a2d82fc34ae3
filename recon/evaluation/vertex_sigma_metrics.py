"""Scores of the sigma of vertices, which predicts the 1-sigma distance to the true surface in metres."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm

from ..core.errors import DataError
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from ..sensors.error_quantiles import LEVELS
from .uncertainty_calibration import rank_correlation, sparsification

MEDIAN_IN_SIGMAS = float(norm.ppf(0.75))  # 0.674: median of |e| / sigma of a Gaussian error e
CURVE_BINS = 20


@dataclass(frozen=True)
class VertexSigmaCurves:
    """Data for plots.

    nominal, empirical               predicted and empirical ratio of vertices within a multiple of sigma
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

    coverage_1_sigma, _2_sigma   ratio of vertices with d <= sigma, d <= 2 sigma
    median_in_sigmas             median of d / sigma
    sigma_factor                 factor on sigma that makes the median right: above 1, sigma is too small
    rank_correlation             Spearman's, of sigma and d; None if one of them is constant
    ause, ause_random            area between the sparsification curves of sigma, or of a random order, and the oracle's
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
    curves: VertexSigmaCurves


def evaluate_vertex_sigma(
    mesh: Mesh, reference: Mesh, visible: Callable[[np.ndarray], np.ndarray] | None = None
) -> VertexSigmaMetrics:
    """Score the sigma of the vertices of `mesh`, in the frame of `reference`; with `visible` only those that it keeps.

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
    """Score `sigma_m` (N,) > 0 against `distance_m` (N,) >= 0, metres. Raises DataError for other values."""
    distance, sigma = distance_m.astype(np.float64), sigma_m.astype(np.float64)
    if not (np.isfinite(distance).all() and np.isfinite(sigma).all() and (sigma > 0).all()):
        raise DataError("the sigma of every vertex must be a positive length, and the reference not empty")
    order = np.random.default_rng(0).permutation(len(sigma))  # breaks ties of sigma fairly
    distance, sigma = distance[order], sigma[order]
    normalised = distance / sigma
    removed, by_sigma, oracle = sparsification(distance, sigma)
    return VertexSigmaMetrics(
        coverage_1_sigma=float(np.mean(normalised <= 1.0)),
        coverage_2_sigma=float(np.mean(normalised <= 2.0)),
        median_in_sigmas=float(np.median(normalised)),
        sigma_factor=float(np.median(normalised)) / MEDIAN_IN_SIGMAS,
        rank_correlation=rank_correlation(sigma, distance),
        ause=float(np.trapezoid(by_sigma - oracle, removed)),
        ause_random=float(np.trapezoid(1.0 - oracle, removed)),
        median_distance_m=float(np.median(distance)),
        median_sigma_m=float(np.median(sigma)),
        vertices=len(sigma),
        curves=_curves(distance, sigma),
    )


def _curves(distance: np.ndarray, sigma: np.ndarray) -> VertexSigmaCurves:
    bins = np.array_split(np.argsort(sigma, kind="stable"), min(CURVE_BINS, len(sigma)))
    return VertexSigmaCurves(
        LEVELS,
        tuple(float(np.mean(distance <= sigma * norm.ppf((1 + level) / 2))) for level in LEVELS),
        tuple(float(sigma[chosen].mean()) for chosen in bins),
        tuple(float(np.sqrt(np.square(distance[chosen]).mean())) for chosen in bins),
    )
