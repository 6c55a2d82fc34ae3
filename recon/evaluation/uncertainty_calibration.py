"""Scores of the calibration of a Laplace scale beta per measurement against the true error.

The density is exp(-|e| / beta) / (2 beta), so E|e| = beta. docs/evaluation.md lists the scores.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import rankdata

from ..sensors.error_quantiles import LEVELS, ErrorQuantiles, level_key

COVERAGES = (0.5, 0.9)


@dataclass(frozen=True)
class CalibrationParameters:
    """Sizes of the samples and histograms of the calibration.

    max_measurements  measurements that are scored; more are thinned at random
    bins              bins of the reliability curve and points of the sparsification curves
    depth_bins        bins of the reference model that predicts beta from the depth alone
    """

    max_measurements: int = 500_000
    bins: int = 20
    depth_bins: int = 64


DEFAULT_PARAMETERS = CalibrationParameters()


@dataclass(frozen=True)
class UncertaintyCurves:
    """Data for plots.

    nominal, empirical           predicted and empirical ratio of errors inside the central interval
    bin_beta_m, bin_error_m      mean beta and mean |error| of measurements in bins of equal size, by rising beta
    removed                      ratio of measurements removed, the least certain first
    error_by_beta, error_oracle  mean |error| of the rest over that of all: removed by beta, by the error itself
    error_by_depth               the same, removed by the depth-only model; () where no depth is given
    """

    nominal: tuple[float, ...]
    empirical: tuple[float, ...]
    bin_beta_m: tuple[float, ...]
    bin_error_m: tuple[float, ...]
    removed: tuple[float, ...]
    error_by_beta: tuple[float, ...]
    error_oracle: tuple[float, ...]
    error_by_depth: tuple[float, ...] = ()


@dataclass(frozen=True)
class UncertaintyMetrics:
    """Scores of beta against the error of the same measurement.

    nll_nats           mean negative log-likelihood per measurement (error in metres); lower is better
    nll_constant_nats  the same for the best constant beta, which is the mean |error|
    coverage_50, _90   ratio of errors inside the central 50 and 90 % intervals of the Laplace distribution
    calibrated_coverage_50, _90   the same for the calibrated quantiles of the sensor, where the map has them
    ause               area between the sparsification curves of beta and of the oracle, both over the mean |error| of
                       all; 0 is the oracle
    ause_random        the same for a random order
    ause_depth         the same for a beta that is a function of depth alone, fitted to the truth (`depth_only_beta`)
    ause_gain          1 - ause / ause_depth: 1 is the oracle, 0 is as good as depth alone, below 0 is worse
    nll_depth_nats     negative log-likelihood of the depth-only beta
    rank_correlation   Spearman's, of beta and |error|; None if one of them is constant
    measurements, scored_measurements   all, and those left after thinning

    What needs the depth of the measurements, or calibrated quantiles, is None without them.
    """

    nll_nats: float
    nll_constant_nats: float
    coverage_50: float
    coverage_90: float
    ause: float
    ause_random: float
    rank_correlation: float | None
    mean_error_m: float
    mean_beta_m: float
    measurements: int
    scored_measurements: int
    seed: int
    curves: UncertaintyCurves
    ause_depth: float | None = None
    ause_gain: float | None = None
    nll_depth_nats: float | None = None
    calibrated_coverage_50: float | None = None
    calibrated_coverage_90: float | None = None


def evaluate_uncertainty(
    error_m: np.ndarray,
    beta_m: np.ndarray,
    depth_m: np.ndarray | None = None,
    *,
    quantiles: ErrorQuantiles | None = None,
    max_measurements: int = DEFAULT_PARAMETERS.max_measurements,
    seed: int = 0,
    parameters: CalibrationParameters = DEFAULT_PARAMETERS,
) -> UncertaintyMetrics:
    """Score `beta_m` (N,) > 0 against `error_m` (N,), the signed or absolute error of the same measurements, metres.

    With the measured `depth_m` (N,) beta is also compared with a depth-only beta; with `quantiles` (calibrated
    quantiles of |error| / beta) their coverage is scored, too. More than `max_measurements` are thinned at random.
    Raises ValueError for other shapes, no measurement or a beta <= 0.
    """
    error, beta = np.abs(np.ravel(error_m)).astype(np.float64), np.ravel(beta_m).astype(np.float64)
    if error.shape != beta.shape or len(error) == 0:
        raise ValueError(f"error and beta must have one value per measurement, got {error.shape} and {beta.shape}")
    if not (np.isfinite(error).all() and np.isfinite(beta).all() and (beta > 0).all()):
        raise ValueError("errors must be finite and every beta positive")
    depth = None if depth_m is None else np.ravel(depth_m).astype(np.float64)
    if depth is not None and (depth.shape != beta.shape or not np.isfinite(depth).all()):
        raise ValueError(f"depth must have one finite value per beta, got {depth.shape} and {beta.shape}")
    count = len(error)
    order = np.random.default_rng(seed).permutation(count)[:max_measurements]  # also breaks ties of beta fairly
    error, beta = error[order], beta[order]
    removed, by_beta, oracle = sparsification(error, beta)
    constant = max(error.mean(), np.finfo(float).tiny)
    coverage_50, coverage_90 = (interval_coverage(error, beta, level) for level in COVERAGES)
    calibrated_50, calibrated_90 = (_quantile_coverage(error, beta, quantiles, level) for level in COVERAGES)
    metrics = UncertaintyMetrics(
        nll_nats=laplace_nll(error, beta),
        nll_constant_nats=laplace_nll(error, np.full_like(error, constant)),
        coverage_50=coverage_50,
        coverage_90=coverage_90,
        ause=float(np.trapezoid(by_beta - oracle, removed)),
        ause_random=float(np.trapezoid(1.0 - oracle, removed)),
        rank_correlation=rank_correlation(beta, error),
        mean_error_m=float(error.mean()),
        mean_beta_m=float(beta.mean()),
        measurements=count,
        scored_measurements=len(error),
        seed=seed,
        curves=_curves(error, beta, removed, by_beta, oracle, parameters.bins),
        calibrated_coverage_50=calibrated_50,
        calibrated_coverage_90=calibrated_90,
    )
    return metrics if depth is None else _with_depth_only(metrics, error, depth[order], parameters)


def _quantile_coverage(
    error: np.ndarray, beta: np.ndarray, quantiles: ErrorQuantiles | None, level: float
) -> float | None:
    """Ratio of errors inside the calibrated quantile of probability `level`; None without quantiles."""
    return float(np.mean(error <= quantiles[level_key(level)] * beta)) if quantiles else None


def _with_depth_only(
    metrics: UncertaintyMetrics, error: np.ndarray, depth: np.ndarray, parameters: CalibrationParameters
) -> UncertaintyMetrics:
    """`metrics` with the scores of the depth-only beta."""
    beta = depth_only_beta(depth, error, parameters.depth_bins)
    removed, by_depth, oracle = sparsification(error, beta)
    ause = float(np.trapezoid(by_depth - oracle, removed))
    curve = tuple(by_depth[_curve_points(len(removed), parameters.bins)].tolist())
    return replace(
        metrics,
        ause_depth=ause,
        ause_gain=1.0 - metrics.ause / ause if ause > 0 else None,
        nll_depth_nats=laplace_nll(error, beta),
        curves=replace(metrics.curves, error_by_depth=curve),
    )


def depth_only_beta(depth: np.ndarray, error: np.ndarray, bin_count: int = DEFAULT_PARAMETERS.depth_bins) -> np.ndarray:
    """The best beta = f(depth), fitted to the true |error| (N,): (N,) metres, positive.

    f interpolates linearly between the mean |error| of `bin_count` bins of equally many measurements. That mean is the
    maximum-likelihood Laplace scale of a bin and the best order for sparsification, and f need not rise, so no other
    function of depth is much better. It is a reference: it uses the truth, which a user does not have.
    """
    bins = np.array_split(np.argsort(depth, kind="stable"), min(bin_count, len(depth)))
    centre = np.array([depth[chosen].mean() for chosen in bins])
    mean = np.array([error[chosen].mean() for chosen in bins])
    return np.maximum(np.interp(depth, centre, mean), np.finfo(float).tiny)


def laplace_nll(error: np.ndarray, beta: np.ndarray) -> float:
    """Mean of |e| / beta + ln(2 beta), in nats."""
    return float(np.mean(np.abs(error) / beta + np.log(2.0 * beta)))


def interval_coverage(error: np.ndarray, beta: np.ndarray, level: float) -> float:
    """Ratio of errors inside the central interval of probability `level`: |e| <= -beta ln(1 - level)."""
    return float(np.mean(np.abs(error) <= -beta * np.log1p(-level)))


def sparsification(error: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ratio removed (N,), and mean |error| of the rest over that of all (N,): by falling beta, and by falling error.

    All ones if every error is 0.
    """
    count, mean = len(error), error.mean()
    removed = np.arange(count) / count
    if mean == 0:
        return removed, np.ones(count), np.ones(count)

    def remaining(order: np.ndarray) -> np.ndarray:  # mean over the k first, from k = N down to 1
        return (np.cumsum(error[order]) / np.arange(1, count + 1))[::-1] / mean

    return removed, remaining(np.argsort(beta, kind="stable")), remaining(np.argsort(error, kind="stable"))


def rank_correlation(a: np.ndarray, b: np.ndarray) -> float | None:
    """Spearman's rank correlation of (N,) and (N,), None if it is not defined."""
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    return float(np.corrcoef(rankdata(a), rankdata(b))[0, 1])


def _curves(
    error: np.ndarray, beta: np.ndarray, removed: np.ndarray, by_beta: np.ndarray, oracle: np.ndarray, bin_count: int
) -> UncertaintyCurves:
    bins = np.array_split(np.argsort(beta, kind="stable"), min(bin_count, len(beta)))
    points = _curve_points(len(removed), bin_count)
    return UncertaintyCurves(
        nominal=LEVELS,
        empirical=tuple(interval_coverage(error, beta, level) for level in LEVELS),
        bin_beta_m=tuple(float(beta[chosen].mean()) for chosen in bins),
        bin_error_m=tuple(float(error[chosen].mean()) for chosen in bins),
        removed=tuple(removed[points].tolist()),
        error_by_beta=tuple(by_beta[points].tolist()),
        error_oracle=tuple(oracle[points].tolist()),
    )


def _curve_points(count: int, bin_count: int) -> np.ndarray:
    """Indices of the points that represent a sparsification curve of `count` points."""
    return np.linspace(0, count - 1, min(bin_count, count)).astype(int)
