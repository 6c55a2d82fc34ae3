"""The Laplace likelihood against SciPy and calculus, and the loss of its intervals."""

import math

import numpy as np
import pytest
import torch
from scipy.stats import laplace
from uncle.recon.sensors.likelihood import QUANTILE_LEVELS, laplace_nll, quantile_loss


def test_agrees_with_scipy():
    residual = np.linspace(-0.5, 0.5, 101)
    for beta in (0.001, 0.05, 2.0):
        found = laplace_nll(torch.from_numpy(residual), torch.tensor(beta, dtype=torch.float64))
        np.testing.assert_allclose(found.numpy(), -laplace.logpdf(residual, scale=beta), rtol=1e-10)


def test_is_the_logarithm_of_a_density():
    residual = torch.linspace(-10, 10, 200001, dtype=torch.float64)
    density = torch.exp(-laplace_nll(residual, torch.tensor(0.3, dtype=torch.float64)))
    assert float(torch.trapezoid(density, residual)) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("residual", [0.02, -0.3])
def test_minimal_where_beta_is_the_residual(residual):
    beta = torch.logspace(-3, 1, 4001, dtype=torch.float64)
    best = beta[laplace_nll(torch.tensor(residual, dtype=torch.float64), beta).argmin()]
    assert float(best) == pytest.approx(abs(residual), rel=0.003)
    beta = torch.tensor(abs(residual), dtype=torch.float64, requires_grad=True)
    laplace_nll(torch.tensor(residual, dtype=torch.float64), beta).backward()
    assert float(beta.grad) == pytest.approx(0.0, abs=1e-9)


def best_scale(errors: torch.Tensor) -> float:
    """The constant beta of the smallest interval loss, by a fine search."""
    scales = torch.logspace(-2, 1, 400)
    return float(scales[torch.stack([quantile_loss(errors, scale).mean() for scale in scales]).argmin()])


def test_intervals_of_laplace_errors_are_best_at_their_scale():
    uniform = torch.linspace(-0.5, 0.5, 20_003)[1:-1]
    errors = -0.3 * uniform.sign() * torch.log1p(-2 * uniform.abs())
    assert best_scale(errors) == pytest.approx(0.3, rel=0.03)


def test_intervals_of_other_errors_miss_both_levels_by_as_much():
    errors = torch.linspace(-1, 1, 20_001)  # flat: no scale covers half and nine tenths
    beta = best_scale(errors)
    half, most = (float((errors.abs() <= -beta * math.log(1 - level)).float().mean()) for level in QUANTILE_LEVELS)
    assert most > 0.97
    assert 0.5 - half == pytest.approx(most - 0.9, abs=0.02)


def test_a_small_error_counts_as_much_as_a_large_one():
    beta = torch.tensor([0.001, 0.1])
    assert quantile_loss(2 * beta, beta)[0] == pytest.approx(float(quantile_loss(2 * beta, beta)[1]))
    assert torch.isfinite(quantile_loss(torch.zeros(1), beta)).all()
