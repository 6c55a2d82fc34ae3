"""The Cauchy kernel against its definition, for arrays and tensors."""

import numpy as np
import pytest
import torch
from uncle.recon.core.robust import cauchy


def test_weight_is_the_derivative_of_the_cost():
    ratio, step = np.array([0.1, 1.0, 30.0]), 1e-6
    _, divisor = cauchy(ratio)
    slope = (cauchy(ratio + step)[0] - cauchy(ratio - step)[0]) / (2 * step)
    np.testing.assert_allclose(1 / divisor, slope, rtol=1e-6)


def test_small_residuals_cost_their_square_and_large_ones_much_less():
    cost, divisor = cauchy(np.array([1e-8, 99.0]))
    assert cost[0] == pytest.approx(1e-8)
    assert cost[1] == pytest.approx(np.log(100))
    assert divisor[1] == 100


def test_tensors_give_the_same():
    ratio = np.linspace(0, 5, 7)
    for array, tensor in zip(cauchy(ratio), cauchy(torch.from_numpy(ratio)), strict=True):
        np.testing.assert_allclose(tensor.numpy(), array, rtol=1e-15)
