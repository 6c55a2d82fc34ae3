"""Calibration scores on errors drawn from the stated distribution, and from another."""

import numpy as np
import pytest
from scipy import stats
from uncle.recon.evaluation.uncertainty_calibration import depth_only_beta, evaluate_uncertainty, sparsification

COUNT = 200_000


@pytest.fixture(scope="module")
def laplace():
    """Errors (N,) that follow beta (N,) exactly, in metres."""
    rng = np.random.default_rng(0)
    beta = np.exp(rng.uniform(np.log(0.005), np.log(0.1), COUNT))
    return rng.laplace(0.0, beta), beta


def test_right_beta_covers_what_it_states(laplace):
    metrics = evaluate_uncertainty(*laplace)
    assert metrics.coverage_50 == pytest.approx(0.5, abs=0.005)
    assert metrics.coverage_90 == pytest.approx(0.9, abs=0.005)
    np.testing.assert_allclose(metrics.curves.empirical, metrics.curves.nominal, atol=0.005)
    np.testing.assert_allclose(metrics.curves.bin_error_m, metrics.curves.bin_beta_m, rtol=0.05)


def test_likelihood_is_the_analytic_one_and_that_of_scipy(laplace):
    error, beta = laplace
    metrics = evaluate_uncertainty(error, beta)
    assert metrics.nll_nats == pytest.approx(-stats.laplace.logpdf(error, scale=beta).mean(), abs=1e-9)
    assert metrics.nll_nats == pytest.approx(1.0 + np.log(2.0 * beta).mean(), abs=0.01)
    assert metrics.nll_constant_nats == pytest.approx(1.0 + np.log(2.0 * np.abs(error).mean()), abs=1e-9)
    assert metrics.nll_nats < metrics.nll_constant_nats


def test_no_constant_beta_is_likelier_than_the_one_compared_with(laplace):
    error, _ = laplace
    best = evaluate_uncertainty(error, np.ones(COUNT)).nll_constant_nats
    for factor in (0.8, 0.95, 1.05, 1.25):
        other = np.full(COUNT, factor * np.abs(error).mean())
        assert evaluate_uncertainty(error, other).nll_nats > best


def test_halved_beta_is_found_out(laplace):
    error, beta = laplace
    halved = evaluate_uncertainty(error, beta / 2)
    assert halved.coverage_50 == pytest.approx(1 - np.sqrt(0.5), abs=0.005)
    assert halved.coverage_90 == pytest.approx(1 - np.sqrt(0.1), abs=0.005)
    right = evaluate_uncertainty(error, beta)
    assert halved.nll_nats == pytest.approx(right.nll_nats + 1.0 - np.log(2.0), abs=0.01)
    assert halved.ause == pytest.approx(right.ause, abs=1e-12)  # the order is the same


def test_rank_correlation_is_spearmans(laplace):
    error, beta = laplace
    metrics = evaluate_uncertainty(error, beta)
    assert metrics.rank_correlation == pytest.approx(stats.spearmanr(beta, np.abs(error)).statistic, abs=1e-9)
    assert 0.3 < metrics.rank_correlation < 1.0


def test_oracle_has_no_sparsification_error_and_noise_the_random_one(laplace):
    error, beta = laplace
    oracle = evaluate_uncertainty(error, np.abs(error) + 1e-9)
    assert oracle.ause == pytest.approx(0.0, abs=1e-9)
    assert oracle.rank_correlation == pytest.approx(1.0)
    ignorant = evaluate_uncertainty(error, np.full(COUNT, 0.03))
    assert ignorant.ause == pytest.approx(ignorant.ause_random, abs=0.01)
    assert ignorant.rank_correlation is None
    assert 0.0 < evaluate_uncertainty(error, beta).ause < 0.7 * ignorant.ause
    inverted = evaluate_uncertainty(error, 1.0 / (np.abs(error) + 1e-6))
    assert inverted.ause > ignorant.ause


def test_sparsification_of_four_readings_by_hand():
    removed, by_beta, oracle = sparsification(np.array([1.0, 2.0, 3.0, 6.0]), np.array([2.0, 1.0, 3.0, 4.0]))
    np.testing.assert_allclose(removed, [0.0, 0.25, 0.5, 0.75])
    np.testing.assert_allclose(by_beta, np.array([3.0, 2.0, 1.5, 2.0]) / 3.0)
    np.testing.assert_allclose(oracle, np.array([3.0, 2.0, 1.5, 1.0]) / 3.0)


def test_thinning_is_seeded_and_stated(laplace):
    first, again, other = (evaluate_uncertainty(*laplace, max_measurements=5000, seed=seed) for seed in (1, 1, 2))
    assert first == again
    assert first.nll_nats != other.nll_nats
    assert (first.measurements, first.scored_measurements) == (COUNT, 5000)
    assert first.coverage_50 == pytest.approx(0.5, abs=0.03)


def test_perfect_readings_do_not_divide_by_zero():
    metrics = evaluate_uncertainty(np.zeros(10), np.linspace(0.1, 0.2, 10))
    assert metrics.ause == 0.0
    assert metrics.coverage_50 == 1.0
    assert np.isfinite(metrics.nll_nats)


@pytest.mark.parametrize(
    ("error", "beta"), [([], []), ([1.0, 2.0], [1.0]), ([1.0], [0.0]), ([np.nan], [1.0]), ([1.0], [np.inf])]
)
def test_senseless_input_is_refused(error, beta):
    with pytest.raises(ValueError, match="beta"):
        evaluate_uncertainty(np.array(error), np.array(beta))


def test_beta_of_depth_alone_is_the_bar():
    """Errors whose scale is that of depth times one that depth does not tell: knowing both beats knowing depth."""
    rng = np.random.default_rng(1)
    depth, factor = rng.uniform(1, 4, COUNT), rng.choice([0.3, 1.0, 3.0], COUNT)
    beta = 0.002 * depth**2 * factor
    error = rng.laplace(0.0, beta)
    metrics = evaluate_uncertainty(error, beta, depth)
    np.testing.assert_allclose(
        depth_only_beta(depth, np.abs(error)), 0.002 * depth**2 * np.mean([0.3, 1, 3]), rtol=0.15
    )
    assert 0.0 < metrics.ause < metrics.ause_depth < metrics.ause_random
    assert metrics.ause_gain == pytest.approx(1 - metrics.ause / metrics.ause_depth)
    assert metrics.nll_nats < metrics.nll_depth_nats < metrics.nll_constant_nats
    by_depth = evaluate_uncertainty(error, 0.002 * depth**2, depth)
    assert by_depth.ause_gain == pytest.approx(0.0, abs=0.01)  # what depth tells in another way is no gain
    assert evaluate_uncertainty(error, np.abs(error) + 1e-9, depth).ause_gain == pytest.approx(1.0)
    assert evaluate_uncertainty(error, np.full(COUNT, 0.01), depth).ause_gain < 0.0


def test_depth_that_tells_nothing_is_as_good_as_no_order(laplace):
    error, beta = laplace
    metrics = evaluate_uncertainty(error, beta, np.random.default_rng(2).uniform(1, 4, COUNT))
    assert metrics.ause_depth == pytest.approx(metrics.ause_random, rel=0.05)  # a fit to the errors themselves
    assert metrics.nll_depth_nats == pytest.approx(metrics.nll_constant_nats, abs=0.01)


def test_the_model_of_depth_need_not_rise():
    depth = np.linspace(1, 4, 50_000)
    error = np.where(depth < 2, 0.05, 0.01)
    near = np.abs(depth - 2) < 0.1
    np.testing.assert_allclose(depth_only_beta(depth, error)[~near], error[~near])


def test_without_depths_nothing_is_said_of_them(laplace):
    metrics = evaluate_uncertainty(*laplace)
    assert (metrics.ause_depth, metrics.ause_gain, metrics.nll_depth_nats) == (None, None, None)
    assert metrics.curves.error_by_depth == ()
    error, beta = laplace
    assert len(evaluate_uncertainty(error, beta, beta).curves.error_by_depth) == len(metrics.curves.removed)


def test_depths_must_fit_the_readings():
    with pytest.raises(ValueError, match="depth"):
        evaluate_uncertainty(np.ones(3), np.ones(3), np.ones(2))
    with pytest.raises(ValueError, match="depth"):
        evaluate_uncertainty(np.ones(3), np.ones(3), np.array([1.0, np.nan, 1.0]))


def test_perfect_readings_leave_nothing_to_gain():
    metrics = evaluate_uncertainty(np.zeros(10), np.linspace(0.1, 0.2, 10), np.linspace(1, 2, 10))
    assert (metrics.ause_depth, metrics.ause_gain) == (0.0, None)
