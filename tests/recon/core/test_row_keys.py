import numpy as np
import pytest
from uncle.recon.core.row_keys import row_keys


@pytest.mark.parametrize("extent", [5, 1 << 40])
def test_keys_are_equal_and_ordered_as_their_rows(extent):
    rows = np.random.default_rng(0).integers(-extent, extent, (3000, 3))
    rows[1000:2000] = rows[:1000]
    expected, inverse = np.unique(rows, axis=0, return_inverse=True)
    keys, of_row = np.unique(row_keys(rows), return_inverse=True)
    assert len(keys) == len(expected)
    np.testing.assert_array_equal(of_row, inverse.reshape(-1))


def test_no_rows_have_no_keys():
    assert row_keys(np.zeros((0, 3), np.int64)).shape == (0,)
