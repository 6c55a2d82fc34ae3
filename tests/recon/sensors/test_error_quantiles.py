"""Quantiles of a sensor's errors in units of beta."""

import numpy as np
import pytest
from uncle.recon.evaluation.uncertainty_calibration import evaluate_uncertainty
from uncle.recon.sensors.error_quantiles import LEVELS, MIN_MEASUREMENTS, fit_error_quantiles, level_key


def test_quantiles_of_flat_errors():
    quantiles = fit_error_quantiles(np.random.default_rng(0).permutation(np.linspace(0, 2, 10_001)))
    assert list(quantiles) == [level_key(level) for level in LEVELS] == [str(n) for n in range(5, 100, 5)]
    for level in LEVELS:
        assert quantiles[level_key(level)] == pytest.approx(2 * level, abs=1e-3)


def test_too_few_give_nothing():
    assert fit_error_quantiles(np.ones(MIN_MEASUREMENTS - 1)) == {}
    assert fit_error_quantiles(np.ones(MIN_MEASUREMENTS))["50"] == 1.0


def test_their_coverage_is_right_where_that_of_laplace_is_not():
    rng = np.random.default_rng(1)
    beta = rng.uniform(0.01, 0.1, 40_000)
    error = beta * rng.uniform(-2, 2, 40_000)
    quantiles = fit_error_quantiles(rng.uniform(0, 2, 5000))
    metrics = evaluate_uncertainty(error, beta, quantiles=quantiles)
    assert metrics.calibrated_coverage_50 == pytest.approx(0.5, abs=0.03)
    assert metrics.calibrated_coverage_90 == pytest.approx(0.9, abs=0.03)
    assert metrics.coverage_50 < 0.4
    alone = evaluate_uncertainty(error, beta)
    assert alone.calibrated_coverage_50 is None
    assert alone.calibrated_coverage_90 is None
