"""What readings are worth: sensors and colours whose errors are known, and when nothing can be told."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from uncle.recon.core.config.uncle import FusionConfig
from uncle.recon.mvs import sensor_reliability as reading_worth
from uncle.recon.mvs.sensor_reliability import DEFAULT_RELIABILITY, CrossViewSamples, estimate_reliability, statements
from uncle.recon.sensors.fusion_weights import FusionWeights

VIEWS, PLACES, VOXEL_M, BETA_M = 24, 400, 0.02, 0.004


def apart() -> np.ndarray:
    return np.eye(VIEWS, dtype=bool)


def made_statements(seed: int = 0, repeats: bool = True, color_group: int = 1) -> CrossViewSamples:
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
    return CrossViewSamples(spots, views, offsets, np.ones_like(offsets), beta)


def worth(said: CrossViewSamples, related: np.ndarray | None = None) -> dict[str, float]:
    return estimate_reliability(said, apart() if related is None else related, VOXEL_M, ("a", "b"))


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
    assert found["b"] == pytest.approx(DEFAULT_RELIABILITY, rel=0.05)
    assert 0.6 < found["a"] < 1.6


@pytest.mark.parametrize("why", ["few", "unsure", "alone", "silent"])
def test_nothing_can_be_told(why):
    said = made_statements()
    if why == "few":
        said = CrossViewSamples(*(values[:500] for values in vars(said).values()))
    elif why == "unsure":
        said.beta[:] = 2 * VOXEL_M
    elif why == "alone":
        said.points[:, 1] = np.arange(len(said.views))  # no two readings of a place
    else:
        said.offsets[:, -1] = np.nan
    assert worth(said) == {"a": DEFAULT_RELIABILITY, "b": DEFAULT_RELIABILITY}


def test_what_one_source_alone_predicts_does_not_count():
    said = made_statements()
    alone = made_statements(1)
    alone.points[:, 0] += 1000.0
    alone.offsets[:, 1] = np.nan  # and no colour but that to be predicted
    related = np.kron(np.eye(2, dtype=bool), np.ones((VIEWS, VIEWS), dtype=bool))
    related[:VIEWS, :VIEWS] = apart()
    alone.views[:] += VIEWS
    both = CrossViewSamples(*map(np.concatenate, zip(vars(said).values(), vars(alone).values(), strict=True)))
    expected = worth(said)
    assert worth(both, related) == pytest.approx(expected, rel=1e-6)


def test_many_readings_of_a_place_are_thinned(monkeypatch):
    rng = np.random.default_rng(0)
    ordered = made_statements()
    order = rng.permutation(len(ordered.views))
    said = CrossViewSamples(*(values[order] for values in vars(ordered).values()))
    every, pairs = worth(said), PLACES * VIEWS * (VIEWS - 1) // 2
    monkeypatch.setattr(reading_worth, "MAX_PAIRS", pairs // 4)
    thinned = reading_worth._thinned(said, 0.75 * VOXEL_M)
    left = len(cKDTree(thinned.points).query_pairs(0.75 * VOXEL_M))
    assert left == pytest.approx(pairs / 4, rel=0.1)
    some = worth(said)
    assert some["a"] == pytest.approx(every["a"], rel=0.5)
    assert some["b"] < 0.3


# --- what the witness heard --------------------------------------------------------------------------------------
class Known:
    """A bias of 1 cm and a beta of 2 cm, everywhere."""

    device = torch.device("cpu")

    def of(self, features):
        return torch.full((len(features),), 0.01)

    def beta_image(self, depth, features):
        return torch.full_like(depth, 0.02) * (depth > 0)


class Unbiased(Known):
    def of(self, features):
        return 0.0


def test_statements_are_offsets_from_the_map_by_view():
    """Pixels: both read; "a" reads nothing; "b" is beyond truncation; the map shows nothing."""
    told = {
        "views": torch.tensor([2, 2, 0, 0]),
        "expected": torch.tensor([2.0, 2.0, 3.0, 0.0]),
        "color": torch.tensor([2.005, 1.99, 3.0, 1.0]),
        "beta": torch.tensor([0.01, 0.02, 0.03, 0.04]).half(),
        "sensors": torch.tensor([[2.02, 1.98], [0.0, 2.0], [3.03, 3.2], [1.0, 1.0]]),
        "inputs": torch.zeros(4, 2, 5).half(),
    }
    points = torch.arange(12.0).view(4, 3)
    witness = SimpleNamespace(samples=told, points=lambda: points)
    weights = FusionWeights(FusionConfig(voxel_size_m=0.02, discretisation_voxels=0), ("a", "b"))
    said = statements(witness, {"a": Known(), "b": Known()}, {"a": Known(), "b": Unbiased()}, weights, 0.1)
    nan = np.nan
    offsets = [[0.01, -0.02, 0.005], [nan, 0.0, -0.01], [0.02, nan, 0.0]]
    np.testing.assert_allclose(said.offsets, offsets, atol=1e-6)
    np.testing.assert_array_equal(said.views, [2, 2, 0])
    np.testing.assert_array_equal(said.points, points[:3])
    np.testing.assert_allclose(said.beta, [0.01, 0.02, 0.03], rtol=1e-3)
    np.testing.assert_allclose(said.weights[[0, 2], 0], 0.25, rtol=1e-4)
    np.testing.assert_allclose(said.weights[:, 1], 0.25, rtol=1e-4)
    np.testing.assert_allclose(said.weights[:, 2], 1e-4 / said.beta**2, rtol=1e-3)
