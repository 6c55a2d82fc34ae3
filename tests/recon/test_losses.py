"""The Laplace likelihood against SciPy and calculus."""

import numpy as np
import pytest
import torch
from scipy.stats import laplace
from uncle.recon.losses import laplace_nll


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
