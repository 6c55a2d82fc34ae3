import numpy as np
import pytest
from uncle.recon.core.time_stamps import common_units, unit_of

FRAMES = np.arange(20) / 30


@pytest.mark.parametrize("start", [0.0, 12.5, 4000.0, 1.6e9])
@pytest.mark.parametrize(("factor", "name"), [(1, "seconds"), (1e3, "milli"), (1e6, "micro"), (1e9, "nano")])
def test_unit_by_size_or_step(start, factor, name):
    assert unit_of((start + FRAMES) * factor).name.startswith(name)


def test_units_of_little_information():
    assert unit_of(np.zeros(0)).name == unit_of(np.array([np.nan])).name == unit_of(np.arange(5.0)).name == "seconds"
    assert unit_of(np.array([1.6e18])).name == "nanoseconds"
    assert unit_of(1.6e9 + 15 * np.arange(9)).name == "seconds", "keyframes"


def test_streams_that_overlap_have_one_unit():
    sparse = 15.0 * np.arange(5)
    assert [unit.name for unit in common_units(FRAMES * 100, sparse)] == ["seconds", "seconds"]
    assert [unit.name for unit in common_units(FRAMES, 1e3 * FRAMES + 500)] == ["seconds", "milliseconds"]


@pytest.mark.parametrize(("factor", "name"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")])
def test_streams_that_both_begin_at_0_can_have_different_units(factor, name):
    assert [unit.name for unit in common_units(FRAMES, FRAMES * factor)] == ["seconds", name]
    assert [unit.name for unit in common_units(FRAMES * factor, FRAMES[:9])] == [name, "seconds"]
