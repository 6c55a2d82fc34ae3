"""The usual residual follows the residuals that it accepts, and rejects much larger ones."""

import pytest
from uncle.recon.tracking.localisation import MAX_RESIDUAL_RATIO, UsualResidual


def test_the_first_residual_is_usual_whatever_it_is():
    usual = UsualResidual()
    assert usual.accepts(7.0)
    assert usual.mean == 7.0


def test_much_larger_residuals_are_rejected_and_change_nothing():
    usual = UsualResidual()
    usual.accepts(1.0)
    assert not usual.accepts(MAX_RESIDUAL_RATIO + 0.01)
    assert usual.mean == 1.0


def test_the_mean_follows_slowly():
    usual = UsualResidual()
    usual.accepts(1.0)
    assert usual.accepts(2.0)
    assert 1.0 < usual.mean < 1.5
    for _ in range(100):
        usual.accepts(2.0)
    assert usual.mean == pytest.approx(2.0, abs=1e-3)
