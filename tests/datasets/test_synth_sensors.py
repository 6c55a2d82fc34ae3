"""Sensor simulation against what the models promise."""

import numpy as np
import pytest
from scipy.stats import norm
from uncle.datasets.synth import sensors, stereo

FOCAL = 96.0


def plane(z: float, shape: tuple[int, int] = (192, 192)) -> np.ndarray:
    return np.full(shape, z, dtype=np.float32)


def slanted_floor(height_m: float = 1.4, shape: tuple[int, int] = (192, 192)) -> np.ndarray:
    """Depth of a horizontal floor seen by a level camera; 0 above the horizon and beyond 6 m."""
    v = np.arange(shape[0])[:, None] - (shape[0] - 1) / 2
    z = np.where(v > 0, height_m * FOCAL / np.maximum(v, 1e-6), 0)
    return np.broadcast_to(np.where(z < 6, z, 0), shape).astype(np.float32)


@pytest.mark.parametrize("z", [1.0, 2.0, 3.0, 4.5])
def test_handa_quantises_in_steps_of_z_squared_over_351(z):
    reading = sensors.structured_light_handa(plane(z), np.random.default_rng(0))
    levels = np.unique(reading[reading > 0])
    raw = 351.3 / levels  # one unit of raw disparity is one step
    assert len(levels) >= 2
    np.testing.assert_allclose(raw, np.round(raw), atol=1e-3)
    np.testing.assert_allclose(np.diff(levels), levels[:-1] ** 2 / 351, rtol=0.02)


def test_handa_noise_is_a_sixth_of_a_step_and_unbiased():
    z = 2.0
    reading = sensors.structured_light_handa(plane(z), np.random.default_rng(1))
    raw = np.round(351.3 / reading[reading > 0])
    disparity = np.round(8 * 36 / z) / 8
    expected = 35130 / np.round(100 * 36 / disparity)
    # Rounded N(expected, 1/6): the shares of the two neighbouring levels follow from the normal distribution.
    for level in (np.floor(expected), np.ceil(expected)):
        share = norm.cdf((level + 0.5 - expected) * 6) - norm.cdf((level - 0.5 - expected) * 6)
        assert np.mean(raw == level) == pytest.approx(share, abs=0.02)


def test_handa_sees_a_wall_at_three_metres_within_a_centimetre_or_so():
    for focal in (128.0, 192.0, 480.0):
        errors = [
            np.median(np.abs(reading[reading > 0] - z))
            for z in np.linspace(2.8, 3.2, 9)
            for reading in [sensors.structured_light_handa(plane(z, (96, 96)), np.random.default_rng(2), focal)]
        ]
        assert np.mean(errors) < 0.012


def test_handa_matches_most_of_a_plane_and_loses_depth_edges():
    depth = plane(2.0)
    depth[:, 96:] = 1.2
    reading = sensors.structured_light_handa(depth, np.random.default_rng(3))
    flat = np.ones_like(depth, dtype=bool)
    flat[:, 86:106] = False
    flat[:8] = flat[-8:] = flat[:, :8] = flat[:, -8:] = False
    assert np.mean(reading[flat] > 0) > 0.85
    assert np.mean(reading[8:-8, 95:97] > 0) < 0.3


def test_handa_passes_the_same_slope_at_any_resolution():
    fine = sensors.structured_light_handa(slanted_floor(), np.random.default_rng(4), FOCAL)
    true = slanted_floor()
    inner = (true > 0) & (true < 3)
    inner[:, :8] = inner[:, -8:] = inner[-8:] = False
    assert np.mean(fine[inner] > 0) > 0.7
    assert np.median(np.abs(fine - true)[inner & (fine > 0)]) < 0.03


@pytest.mark.parametrize("multiplier", [1.0, 5.0])
def test_redwood_disparity_noise_has_the_stated_deviation(multiplier):
    z = 2.0
    reading = sensors.structured_light_redwood(plane(z, (400, 400)), np.random.default_rng(5), multiplier)
    q = 8 * 35.13 / reading[reading > 0]
    np.testing.assert_allclose(q, np.round(q), atol=1e-3)
    levels = np.arange(100, 200)
    exact, sigma = 8 * 35.13 / z, 8 * multiplier / 36
    shares = norm.cdf((levels + 0.5 - exact) / sigma) - norm.cdf((levels - 0.5 - exact) / sigma)
    mean = np.sum(levels * shares)
    assert np.mean(q) == pytest.approx(mean, abs=0.01)
    assert np.std(q) == pytest.approx(np.sqrt(np.sum((levels - mean) ** 2 * shares)), rel=0.03)


def test_redwood_reads_nothing_from_ten_metres_on_and_halves_the_resolution():
    assert not sensors.structured_light_redwood(plane(10.0), np.random.default_rng(0)).any()
    depth = np.ones((64, 64), dtype=np.float32)
    depth[:, 1::2] = 3.0  # odd columns are never read
    reading = sensors.structured_light_redwood(depth, np.random.default_rng(0))
    assert np.abs(reading - 1.0).max() < 0.05


@pytest.mark.parametrize(
    "simulate",
    [
        lambda depth, rng: sensors.structured_light_handa(depth, rng, FOCAL),
        sensors.structured_light_redwood,
        lambda depth, rng: sensors.time_of_flight(depth, rng, FOCAL),
    ],
)
def test_no_surface_stays_no_reading(simulate):
    assert not simulate(plane(0.0), np.random.default_rng(0)).any()
    depth = plane(2.0)
    depth[:, 60:130] = 0
    reading = simulate(depth, np.random.default_rng(0))
    assert not reading[:, 66:124].any()
    assert np.isfinite(reading).all()
    assert np.median(reading[reading > 0]) == pytest.approx(2.0, abs=0.03)


def test_time_of_flight_noise_grows_with_depth_as_stated():
    for z in (1.0, 3.0):
        reading = sensors.time_of_flight(plane(z, (96, 96)), np.random.default_rng(6), 400.0)
        inner = reading[8:-8, 8:-8]
        assert np.std(inner) == pytest.approx(0.002 + 0.0015 * z**2, rel=0.06)
        assert np.mean(inner) == pytest.approx(z, abs=0.001)


def test_time_of_flight_puts_flying_pixels_only_between_the_two_surfaces_of_an_edge():
    depth = plane(3.0)
    depth[:, 96:] = 1.5
    reading = sensors.time_of_flight(depth, np.random.default_rng(7), FOCAL)
    flying = (reading > 1.7) & (reading < 2.8)
    assert flying[:, 94:98].mean() > 0.1
    assert not np.delete(flying, np.arange(94, 98), axis=1)[:, 4:-4].any()


def test_time_of_flight_reads_concave_corners_too_far_and_convex_ones_not():
    size, focal = 192, 96.0
    x = (np.arange(size) - (size - 1) / 2) / focal
    concave = np.broadcast_to(2.0 / (1 + np.abs(x)), (size, size)).astype(
        np.float32
    )  # walls meeting at 2 m, 90 degrees
    rng = np.random.default_rng(8)
    error = sensors.time_of_flight(concave, rng, focal) - concave
    corner = error[40:-40, 88:104].mean()
    assert 0.004 < corner < 0.05
    convex = np.broadcast_to(1.5 / np.maximum(1 - np.abs(x), 0.4), (size, size)).astype(np.float32)
    error = sensors.time_of_flight(convex, rng, focal) - convex
    assert abs(error[40:-40, 92:100].mean()) < 0.003


def test_normals_of_a_floor_point_up():
    depth = slanted_floor()
    normals = sensors.depth_normals(depth, FOCAL)
    known = normals.any(axis=-1)
    inner = known & (depth < 4) & (depth > 0)
    assert inner.sum() > 1000
    assert np.abs(np.abs(normals[inner][:, 1]) - 1).max() < 1e-3


def textured_pair(disparity: int, size: int = 160) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(9)
    wide = rng.integers(0, 255, (size, size + disparity, 3), dtype=np.uint8)
    return wide[:, :size], wide[:, disparity:]  # what is at u in the left image is at u - disparity in the right one


def test_semi_global_matching_finds_a_textured_wall_and_leaves_the_blind_strip_empty():
    left, right = textured_pair(8)
    reading = stereo.semi_global_matching(left, right, fb=16.0)
    assert np.mean(reading[:, 12:] > 0) > 0.95
    np.testing.assert_allclose(np.median(reading[:, 12:]), 2.0, atol=0.01)
    assert np.mean(reading[:, :6] > 0) < 0.2


def test_dense_stereo_has_no_holes_and_carries_its_bias():
    left, right = textured_pair(8)
    unbiased = stereo.dense_stereo(left, right, 16.0, np.zeros((160, 160), np.float32))
    assert (unbiased > 0).all()
    assert np.median(unbiased) == pytest.approx(2.0, abs=0.02)
    biased = stereo.dense_stereo(left, right, 16.0, np.full((160, 160), -0.5, np.float32))
    assert np.median(biased) == pytest.approx(16 / 7.5, abs=0.02)


def test_dense_stereo_survives_images_without_any_match():
    blank = np.zeros((64, 64, 3), np.uint8)
    reading = stereo.dense_stereo(blank, blank, 16.0, np.zeros((64, 64), np.float32))
    assert np.isfinite(reading).all()
    assert (reading > 0).all()


def test_bias_field_is_smooth_and_of_stated_size():
    field = stereo.bias_field(128, 128, np.random.default_rng(10))
    assert np.std(field) == pytest.approx(0.15, rel=0.01)
    assert np.abs(np.diff(field, axis=0)).max() < 0.03
