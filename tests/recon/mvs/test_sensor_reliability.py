"""Sensor reliability: sensors and photometric depth whose errors are known, and when nothing can be estimated."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from uncle.recon.core.config.uncle import FusionConfig
from uncle.recon.mvs.photometric_samples import PhotometricSamples
from uncle.recon.mvs.sensor_reliability import (
    DEFAULT_RELIABILITY,
    CrossViewSamples,
    ReliabilityParameters,
    collect_samples,
    estimate_reliability,
    thin_samples,
)
from uncle.recon.sensors.fusion_weights import FusionWeights

VIEWS, PLACES, VOXEL_M, BETA_M = 24, 400, 0.02, 0.004


def independent() -> np.ndarray:
    return np.eye(VIEWS, dtype=bool)


def make_samples(seed: int = 0, repeats: bool = True, color_group: int = 1) -> CrossViewSamples:
    """Every view sees every place. The errors of sensor "a" are independent, "b" has the same in all views if it
    `repeats` its error; photometric depth shares errors in `color_group` views in a row. All errors have their beta."""
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


def estimate(
    samples: CrossViewSamples, dependent: np.ndarray | None = None, max_pairs: int = ReliabilityParameters.max_pairs
) -> dict[str, float]:
    dependent, parameters = (
        independent() if dependent is None else dependent,
        ReliabilityParameters(max_pairs=max_pairs),
    )
    return estimate_reliability(samples, dependent, VOXEL_M, ("a", "b"), parameters)


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_repeats_its_error_counts_as_one_measurement(seed):
    reliability = estimate(make_samples(seed))
    assert 0.6 < reliability["a"] < 1.6
    assert reliability["b"] < 4 / VIEWS  # of which there are as many as views; drawn towards 1/3


@pytest.mark.parametrize("seed", range(3))
def test_independent_errors_need_no_factor(seed):
    reliability = estimate(make_samples(seed, repeats=False))
    assert all(0.45 < value < 1.6 for value in reliability.values())  # little depends on it, so it is drawn towards 1/3


def test_photometric_depths_that_share_an_image_do_not_predict_each_other():
    samples = make_samples(color_group=6)
    groups = np.arange(VIEWS) // 6
    right = estimate(samples, groups[:, None] == groups)
    wrong = estimate(samples)
    assert wrong["a"] < 0.8
    assert right["a"] > 2  # its 23 measurements stand against the errors of 3 groups


def test_weights_that_are_too_large_are_compensated():
    samples = make_samples(repeats=False)
    samples.weights[:, 0] *= 10
    reliability = estimate(samples)
    assert 0.06 < reliability["a"] < 0.16
    assert 0.45 < reliability["b"] < 1.6


def test_a_sensor_without_measurements_keeps_the_default():
    samples = make_samples()
    samples.offsets[:, 1] = np.nan
    reliability = estimate(samples)
    assert reliability["b"] == pytest.approx(DEFAULT_RELIABILITY, rel=0.05)
    assert 0.6 < reliability["a"] < 1.6


@pytest.mark.parametrize("why", ["few", "unsure", "alone", "missing"])
def test_too_little_is_known(why):
    samples = make_samples()
    if why == "few":
        samples = CrossViewSamples(*(values[:500] for values in vars(samples).values()))
    elif why == "unsure":
        samples.beta[:] = 2 * VOXEL_M
    elif why == "alone":
        samples.points[:, 1] = np.arange(len(samples.views))  # no two samples of a place
    else:
        samples.offsets[:, -1] = np.nan
    assert estimate(samples) == {"a": DEFAULT_RELIABILITY, "b": DEFAULT_RELIABILITY}


def test_predictions_by_one_source_alone_do_not_count():
    samples = make_samples()
    alone = make_samples(1)
    alone.points[:, 0] += 1000.0
    alone.offsets[:, 1] = np.nan  # and no photometric depth but that to be predicted
    dependent = np.kron(np.eye(2, dtype=bool), np.ones((VIEWS, VIEWS), dtype=bool))
    dependent[:VIEWS, :VIEWS] = independent()
    alone.views[:] += VIEWS
    both = CrossViewSamples(*map(np.concatenate, zip(vars(samples).values(), vars(alone).values(), strict=True)))
    expected = estimate(samples)
    assert estimate(both, dependent) == pytest.approx(expected, rel=1e-6)


def test_many_samples_of_a_place_are_thinned():
    rng = np.random.default_rng(0)
    ordered = make_samples()
    order = rng.permutation(len(ordered.views))
    samples = CrossViewSamples(*(values[order] for values in vars(ordered).values()))
    every, pairs = estimate(samples), PLACES * VIEWS * (VIEWS - 1) // 2
    thinned = thin_samples(samples, 0.75 * VOXEL_M, pairs // 4)
    left = len(cKDTree(thinned.points).query_pairs(0.75 * VOXEL_M))
    assert left == pytest.approx(pairs / 4, rel=0.1)
    some = estimate(samples, max_pairs=pairs // 4)
    assert some["a"] == pytest.approx(every["a"], rel=0.5)
    assert some["b"] < 0.3


# --- samples -----------------------------------------------------------------------------------------------------
class KnownModel:
    """A bias of 1 cm and a beta of 2 cm, everywhere."""

    device = torch.device("cpu")

    def offset(self, inputs):
        return torch.full((len(inputs),), 0.01)

    def beta_image(self, depth, inputs):
        return torch.full_like(depth, 0.02) * (depth > 0)


class Unbiased(KnownModel):
    def offset(self, inputs):
        return 0.0


def test_samples_are_offsets_from_the_map_by_view():
    """Pixels: both measured; "a" did not; "b" is beyond truncation; the map has no surface."""
    points = torch.arange(12.0).view(4, 3)
    photometric = PhotometricSamples(
        ("a", "b"), view=torch.tensor([2, 2, 0, 0]), origins=points, directions=torch.zeros(4, 3),
        depth=torch.tensor([2.005, 1.99, 3.0, 1.0]), beta=torch.tensor([0.01, 0.02, 0.03, 0.04]).half(),
        map_depth=torch.tensor([2.0, 2.0, 3.0, 0.0]),
        sensor_depths=torch.tensor([[2.02, 1.98], [0.0, 2.0], [3.03, 3.2], [1.0, 1.0]]),
        sensor_inputs=torch.zeros(4, 2, 5).half(),
    )  # fmt: skip
    weights = FusionWeights(FusionConfig(voxel_size_m=0.02, discretisation_voxels=0), ("a", "b"))
    models = {"b": KnownModel(), "a": KnownModel()}  # in another order than the columns
    samples = collect_samples(photometric, models, {"b": Unbiased(), "a": KnownModel()}, weights, 0.1)
    nan = np.nan
    offsets = [[0.01, -0.02, 0.005], [nan, 0.0, -0.01], [0.02, nan, 0.0]]
    np.testing.assert_allclose(samples.offsets, offsets, atol=1e-6)
    np.testing.assert_array_equal(samples.views, [2, 2, 0])
    np.testing.assert_array_equal(samples.points, points[:3])
    np.testing.assert_allclose(samples.beta, [0.01, 0.02, 0.03], rtol=1e-3)
    np.testing.assert_allclose(samples.weights[[0, 2], 0], 0.25, rtol=1e-4)
    np.testing.assert_allclose(samples.weights[:, 1], 0.25, rtol=1e-4)
    np.testing.assert_allclose(samples.weights[:, 2], 1e-4 / samples.beta**2, rtol=1e-3)
    with pytest.raises(ValueError, match="columns"):
        estimate_reliability(samples, independent(), 0.02, ("a",))
