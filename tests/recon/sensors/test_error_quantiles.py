"""Intervals that a map states for the errors of a sensor."""

import numpy as np
import pytest
from uncle.recon.evaluation.uncertainty_calibration import evaluate_uncertainty
from uncle.recon.sensors.error_quantiles import LEVELS, MIN_MEASUREMENTS, fit_error_quantiles, level_key


def test_quantiles_of_flat_errors():
    stated = fit_error_quantiles(np.random.default_rng(0).permutation(np.linspace(0, 2, 10_001)))
    assert list(stated) == [level_key(level) for level in LEVELS] == [str(n) for n in range(5, 100, 5)]
    for level in LEVELS:
        assert stated[level_key(level)] == pytest.approx(2 * level, abs=1e-3)


def test_too_few_state_nothing():
    assert fit_error_quantiles(np.ones(MIN_MEASUREMENTS - 1)) == {}
    assert fit_error_quantiles(np.ones(MIN_MEASUREMENTS))["50"] == 1.0


def test_they_cover_what_they_say_where_those_of_laplace_do_not():
    rng = np.random.default_rng(1)
    beta = rng.uniform(0.01, 0.1, 40_000)
    error = beta * rng.uniform(-2, 2, 40_000)
    stated = fit_error_quantiles(rng.uniform(0, 2, 5000))
    metrics = evaluate_uncertainty(error, beta, intervals=stated)
    assert metrics.stated_coverage_50 == pytest.approx(0.5, abs=0.03)
    assert metrics.stated_coverage_90 == pytest.approx(0.9, abs=0.03)
    assert metrics.coverage_50 < 0.4
    alone = evaluate_uncertainty(error, beta)
    assert alone.stated_coverage_50 is None
    assert alone.stated_coverage_90 is None
