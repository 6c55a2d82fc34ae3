"""Does the stated uncertainty agree with the true error? Scores of a Laplace scale beta per reading.

The density is exp(-|e| / beta) / (2 beta), so E|e| = beta.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import rankdata

from ..sensors.error_quantiles import LEVELS, ErrorQuantiles, level_key

COVERAGES = (0.5, 0.9)
BINS = 20  # of the reliability and sparsification curves
DEPTH_BINS = 64  # of the model that knows nothing but the depth of a reading


@dataclass(frozen=True)
class UncertaintyCurves:
    """Data for plots.

    nominal, empirical           stated and found share of errors inside the central interval
    bin_beta_m, bin_error_m      mean beta and mean |error| of readings in bins of equal size, by rising beta
    removed                      share of readings removed, the least certain first
    error_by_beta, error_oracle  mean |error| of the rest over that of all: removed by beta, by the error itself
    error_by_depth               the same, removed by the model that knows the depth alone; () where no depth is given
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
    """Scores of beta against the error of the same reading.

    nll_nats           mean negative log-likelihood per reading (of metres); lower is better
    nll_constant_nats  the same for the best constant beta, which is the mean |error|
    coverage_50, _90   share of errors inside the central 50 and 90 % intervals; right is 0.5 and 0.9
    stated_coverage_50, _90   the same for the intervals that the map states for the sensor instead of those of Laplace
    ause               area between the sparsification curves of beta and of the oracle, both over the mean |error| of
                       all; 0 is the oracle
    ause_random        the same for an order that knows nothing
    ause_depth         the same for a beta that is a function of depth alone, fitted to the truth (`depth_only_beta`)
    ause_gain          1 - ause / ause_depth: how much closer to the oracle than that; 1 is the oracle, below 0 is worse
    nll_depth_nats     negative log-likelihood of the depth-only beta, which knows the truth
    rank_correlation   Spearman's, of beta and |error|; None if one of them is constant

    What needs the depth of the readings, or stated intervals, is None without them.
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
    readings: int
    scored_readings: int
    seed: int
    curves: UncertaintyCurves
    ause_depth: float | None = None
    ause_gain: float | None = None
    nll_depth_nats: float | None = None
    stated_coverage_50: float | None = None
    stated_coverage_90: float | None = None


def evaluate_uncertainty(
    error_m: np.ndarray,
    beta_m: np.ndarray,
    depth_m: np.ndarray | None = None,
    *,
    intervals: ErrorQuantiles | None = None,
    max_readings: int = 500_000,
    seed: int = 0,
) -> UncertaintyMetrics:
    """Score `beta_m` (N,) > 0 against `error_m` (N,), the signed or absolute error of the same readings, in metres.

    With `depth_m` (N,), what the readings say, also against a beta that knows the depth alone; with `intervals`, also
    what those cover. More than `max_readings`
    are thinned at random. Raises ValueError for other shapes, no reading or a beta <= 0.
    """
    error, beta = np.abs(np.ravel(error_m)).astype(np.float64), np.ravel(beta_m).astype(np.float64)
    if error.shape != beta.shape or len(error) == 0:
        raise ValueError(f"error and beta must have one value per reading, got {error.shape} and {beta.shape}")
    if not (np.isfinite(error).all() and np.isfinite(beta).all() and (beta > 0).all()):
        raise ValueError("errors must be finite and every beta positive")
    depth = None if depth_m is None else np.ravel(depth_m).astype(np.float64)
    if depth is not None and (depth.shape != beta.shape or not np.isfinite(depth).all()):
        raise ValueError(f"depth must have one finite value per beta, got {depth.shape} and {beta.shape}")
    readings = len(error)
    order = np.random.default_rng(seed).permutation(readings)[:max_readings]  # also breaks ties of beta fairly
    error, beta = error[order], beta[order]
    removed, by_beta, oracle = sparsification(error, beta)
    constant = max(error.mean(), np.finfo(float).tiny)
    metrics = UncertaintyMetrics(
        laplace_nll(error, beta),
        laplace_nll(error, np.full_like(error, constant)),
        *(interval_coverage(error, beta, level) for level in COVERAGES),
        float(np.trapezoid(by_beta - oracle, removed)),
        float(np.trapezoid(1.0 - oracle, removed)),
        rank_correlation(beta, error),
        float(error.mean()),
        float(beta.mean()),
        readings,
        len(error),
        seed,
        _curves(error, beta, removed, by_beta, oracle),
    )
    for level in COVERAGES if intervals else ():
        covered = float(np.mean(error <= intervals[level_key(level)] * beta))
        metrics = replace(metrics, **{f"stated_coverage_{level_key(level)}": covered})
    return metrics if depth is None else _beside_depth_only(metrics, error, depth[order])


def _beside_depth_only(metrics: UncertaintyMetrics, error: np.ndarray, depth: np.ndarray) -> UncertaintyMetrics:
    """`metrics` with the scores of a beta that knows the depth alone."""
    beta = depth_only_beta(depth, error)
    removed, by_depth, oracle = sparsification(error, beta)
    ause = float(np.trapezoid(by_depth - oracle, removed))
    curve = tuple(by_depth[_marks(len(removed))].tolist())
    return replace(
        metrics,
        ause_depth=ause,
        ause_gain=1.0 - metrics.ause / ause if ause > 0 else None,
        nll_depth_nats=laplace_nll(error, beta),
        curves=replace(metrics.curves, error_by_depth=curve),
    )


def depth_only_beta(depth: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The best beta = f(depth), fitted to the true |error| (N,): (N,) metres, positive.

    f joins the mean |error| of `DEPTH_BINS` bins of equally many readings by straight lines. That mean is the
    likeliest Laplace scale of a bin and the best order for sparsification, and f need not rise, so no other function of
    depth is much better: it is a bar, and uses a truth that a user does not have.
    """
    bins = np.array_split(np.argsort(depth, kind="stable"), min(DEPTH_BINS, len(depth)))
    centre = np.array([depth[chosen].mean() for chosen in bins])
    mean = np.array([error[chosen].mean() for chosen in bins])
    return np.maximum(np.interp(depth, centre, mean), np.finfo(float).tiny)


def laplace_nll(error: np.ndarray, beta: np.ndarray) -> float:
    """Mean of |e| / beta + ln(2 beta), in nats."""
    return float(np.mean(np.abs(error) / beta + np.log(2.0 * beta)))


def interval_coverage(error: np.ndarray, beta: np.ndarray, level: float) -> float:
    """Share of errors inside the central interval of probability `level`: |e| <= -beta ln(1 - level)."""
    return float(np.mean(np.abs(error) <= -beta * np.log1p(-level)))


def sparsification(error: np.ndarray, beta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Share removed (N,), and mean |error| of the rest over that of all (N,): by falling beta, and by falling error.

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
    error: np.ndarray, beta: np.ndarray, removed: np.ndarray, by_beta: np.ndarray, oracle: np.ndarray
) -> UncertaintyCurves:
    bins = np.array_split(np.argsort(beta, kind="stable"), min(BINS, len(beta)))
    marks = _marks(len(removed))
    return UncertaintyCurves(
        LEVELS,
        tuple(interval_coverage(error, beta, level) for level in LEVELS),
        tuple(float(beta[chosen].mean()) for chosen in bins),
        tuple(float(error[chosen].mean()) for chosen in bins),
        tuple(removed[marks].tolist()),
        tuple(by_beta[marks].tolist()),
        tuple(oracle[marks].tolist()),
    )


def _marks(count: int) -> np.ndarray:
    """Positions along a sparsification curve of `count` points that stand for it."""
    return np.linspace(0, count - 1, min(BINS, count)).astype(int)
