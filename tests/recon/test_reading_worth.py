"""What readings are worth: sensors and colours whose errors are known, and when nothing can be told."""

import numpy as np
import pytest
from uncle.recon import reading_worth
from uncle.recon.reading_worth import UNTESTED, Statements, worth_of_readings

VIEWS, PLACES, VOXEL_M, BETA_M = 24, 400, 0.02, 0.004


def apart() -> np.ndarray:
    return np.eye(VIEWS, dtype=bool)


def made_statements(seed: int = 0, repeats: bool = True, color_group: int = 1) -> Statements:
    """Every view sees every place. Sensor "a" errs anew each time, "b" says the same in all views if it `repeats` its
    error; colour errs alike in `color_group` views in a row. All errors have the beta that they are said to have."""
    rng = np.random.default_rng(seed)
    views, places = (axis.ravel() for axis in np.meshgrid(np.arange(VIEWS), np.arange(PLACES), indexing="ij"))

    def noise(groups: np.ndarray) -> np.ndarray:
        return rng.laplace(0, BETA_M, groups.max() + 1)[groups]

    anew = np.arange(len(views))
    alike = (views // color_group) * PLACES + places
    offsets = np.column_stack([noise(anew), noise(places if repeats else anew), noise(alike)])
    spots = np.column_stack([places * 10 * VOXEL_M, *rng.uniform(0, 0.2 * VOXEL_M, (2, len(views)))])
    beta = np.full(len(views), BETA_M)
    return Statements(spots, views, offsets, np.ones_like(offsets), beta)


def worth(said: Statements, related: np.ndarray | None = None) -> dict[str, float]:
    return worth_of_readings(said, apart() if related is None else related, VOXEL_M, ("a", "b"))


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_repeats_its_error_is_worth_one_reading(seed):
    found = worth(made_statements(seed))
    assert 0.6 < found["a"] < 1.6
    assert found["b"] < 4 / VIEWS  # of which there are as many as views; drawn towards 1/3


@pytest.mark.parametrize("seed", range(3))
def test_independent_readings_are_worth_what_their_beta_says(seed):
    found = worth(made_statements(seed, repeats=False))
    assert all(0.45 < value < 1.6 for value in found.values())  # little depends on it, so it is drawn towards 1/3


def test_colours_of_views_with_an_image_in_common_do_not_vouch_for_each_other():
    said = made_statements(color_group=6)
    groups = np.arange(VIEWS) // 6
    told = worth(said, groups[:, None] == groups)
    fooled = worth(said)
    assert fooled["a"] < 0.8
    assert told["a"] > 2  # its 23 readings stand against the errors of 3 groups


def test_weights_that_are_too_large_are_made_up_for():
    said = made_statements(repeats=False)
    said.weights[:, 0] *= 10
    found = worth(said)
    assert 0.06 < found["a"] < 0.16
    assert 0.45 < found["b"] < 1.6


def test_a_sensor_that_says_nothing_stays_where_it_was():
    said = made_statements()
    said.offsets[:, 1] = np.nan
    found = worth(said)
    assert found["b"] == pytest.approx(UNTESTED, rel=0.05)
    assert 0.6 < found["a"] < 1.6


@pytest.mark.parametrize("why", ["few", "unsure", "alone", "silent"])
def test_nothing_can_be_told(why):
    said = made_statements()
    if why == "few":
        said = Statements(*(values[:500] for values in vars(said).values()))
    elif why == "unsure":
        said.beta[:] = 2 * VOXEL_M
    elif why == "alone":
        said.places[:, 1] = np.arange(len(said.views))  # no two readings of a place
    else:
        said.offsets[:, -1] = np.nan
    assert worth(said) == {"a": UNTESTED, "b": UNTESTED}


def test_many_readings_of_a_place_are_thinned(monkeypatch):
    said = made_statements()
    every = worth(said)
    monkeypatch.setattr(reading_worth, "MAX_PAIRS", PLACES * VIEWS * (VIEWS - 1) // 8)
    thinned = reading_worth._thinned(said, 0.75 * VOXEL_M)
    assert len(thinned.views) == len(said.views) // 2
    some = worth(said)
    assert some["a"] == pytest.approx(every["a"], rel=0.5)
    assert some["b"] < 0.3
