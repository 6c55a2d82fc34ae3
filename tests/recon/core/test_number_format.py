"""Numbers as the tables show them."""

import pytest
from uncle.recon.core.number_format import format_cm, format_grouped, format_number, format_percent


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (format_number(1.23456), "1.235"),
        (format_number(0.5, 1, 57.3), "28.6"),  # 28.65 rounds to even
        (format_number(None), "-"),
        (format_cm(0.01234), "1.23"),
        (format_cm(None), "-"),
        (format_percent(0.98765, 1), "98.8"),
        (format_percent(None), "-"),
        (format_grouped(1234567), "1 234 567"),
    ],
)
def test_units_digits_and_unknown_values(text, expected):
    assert text == expected
