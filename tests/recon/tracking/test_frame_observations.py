"""What the tracker takes from frames whose depths and certainties are known."""

import math

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.uncle import TrackingConfig, UncertaintyConfig
from uncle.recon.core.frame import Frame
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS
from uncle.recon.sensors.noise_model import NoiseModel, Residuals
from uncle.recon.tracking.frame_observations import (
    DEFAULT_BETA,
    EDGE_SHARE,
    observe_features,
    prepare,
    sample_depth_points,
    surface_view,
    weigh,
)
from uncle.recon.tracking.local_features import LocalFeatures, no_features

CAMERA = Camera(160, 120, 120.0, 120.0, 79.5, 59.5)
NORMALS = torch.tensor([0.0, 0.0, -1.0]).expand(120, 160, 3)


def image(depth_m: float) -> torch.Tensor:
    return torch.full((120, 160), depth_m)


def frame(**depths: torch.Tensor) -> Frame:
    color = torch.zeros(120, 160, 3, dtype=torch.uint8)
    color[:, 80:] = 200
    return Frame(5, 5.0, color, depths, None)


def taught(beta_m: float) -> NoiseModel:
    """A model that says `beta_m` whatever it sees."""
    model = NoiseModel(UncertaintyConfig(), torch.Generator().manual_seed(0))
    model.learn(
        Residuals.from_exact_reference(torch.ones(20), torch.zeros(20, len(SENSOR_INPUTS))), 1, torch.Generator()
    )
    with torch.no_grad():
        model.layers[-1].weight.zero_()
        model.layers[-1].bias.fill_(math.log(math.expm1(beta_m - model.config.beta_min_m)))
    return model


def seen(made: Frame) -> dict[str, torch.Tensor]:
    return {sensor: torch.zeros(120, 160, len(SENSOR_INPUTS)) for sensor in made.depths}


def features_at(*uv: tuple[float, float]) -> LocalFeatures:
    return LocalFeatures(np.array(uv), np.ones(len(uv)), np.zeros((len(uv), 128), np.float32))


def test_features_carry_the_reading_of_the_nearest_pixel():
    depth = torch.arange(120.0 * 160).view(120, 160)
    made = frame(a=depth, b=image(0.0))
    found = observe_features(made, features_at((10.4, 20.6), (159.4, 119.4), (-0.4, 0.0)), {}, [None, None], CAMERA)
    assert found.depths[:, 0].tolist() == [21 * 160 + 10, 119 * 160 + 159, 0.0]
    assert (found.depths[:, 1] == 0).all()
    assert (found.landmark == -1).all()
    assert found.index == 5
    assert len(observe_features(made, no_features(), {}, [None, None], CAMERA)) == 0


def test_sigmas_are_those_of_each_sensor():
    made = frame(a=image(2.0), b=image(3.0))
    found = observe_features(made, features_at((80.0, 60.0)), seen(made), [taught(0.02), None], CAMERA)
    expected = [math.sqrt(2) * 0.02, math.sqrt(2) * (DEFAULT_BETA[0] + DEFAULT_BETA[1] * 9)]
    np.testing.assert_allclose(found.sigmas_m[0], expected, rtol=1e-5)
    weigh(found, [taught(0.05), taught(0.01)])  # learned since
    np.testing.assert_allclose(found.sigmas_m[0], [math.sqrt(2) * 0.05, math.sqrt(2) * 0.01], rtol=1e-5)


def test_a_model_that_never_learned_is_not_asked():
    made = frame(a=image(2.0))
    fresh = NoiseModel(UncertaintyConfig(), torch.Generator().manual_seed(0))
    found = observe_features(made, features_at((80.0, 60.0)), seen(made), [fresh], CAMERA)
    assert found.sigmas_m[0, 0] == pytest.approx(math.sqrt(2) * (DEFAULT_BETA[0] + DEFAULT_BETA[1] * 4))


def test_a_feature_beside_an_edge_is_less_certain():
    depth = image(2.0)
    depth[:, 80:] = 2.5
    depth[:20] = 0.0  # holes are no edges
    found = observe_features(frame(a=depth), features_at((78.0, 60.0), (40.0, 60.0), (40.0, 21.0)), {}, [None], CAMERA)
    np.testing.assert_allclose(found.edges[:, 0], [0.5, 0.0, 0.0], atol=1e-6)
    flat = math.sqrt(2) * (DEFAULT_BETA[0] + DEFAULT_BETA[1] * 4)
    np.testing.assert_allclose(found.sigmas_m[:, 0], [math.hypot(flat, EDGE_SHARE * 0.5), flat, flat], rtol=1e-5)


def test_the_surface_is_that_of_the_most_certain_sensor():
    good, poor = image(2.0), image(2.2)
    good[:, :40] = 0.0
    good[:10, 40:], poor[:10, 40:] = 0.0, 9.0  # none in reach
    made = frame(poor=poor, good=good)
    prepared = prepare(made, dict.fromkeys(made.depths, NORMALS), CAMERA, TrackingConfig())
    for noise, best, second in (([taught(0.05), taught(0.01)], 2.0, 0.05), ([taught(0.01), taught(0.05)], 2.2, 0.01)):
        found = surface_view(made, prepared, seen(made), noise, CAMERA, 6.0)
        z = found.points[..., 2]
        assert found.valid[20, 100]
        assert z[20, 100] == pytest.approx(best)
        assert found.sigma[20, 100] == pytest.approx(math.sqrt(2) * 0.01, rel=1e-5)
        assert z[20, 10] == pytest.approx(2.2)  # the only one
        assert found.sigma[20, 10] == pytest.approx(math.sqrt(2) * second, rel=1e-5)
        assert not found.valid[5, 100]


def test_a_large_surface_is_thinned_out_with_its_camera():
    camera = Camera(640, 480, 500.0, 500.0, 319.5, 239.5)
    depth = torch.full((480, 640), 2.0)
    made = Frame(0, 0.0, torch.zeros(480, 640, 3, dtype=torch.uint8), {"a": depth}, None)
    normals = torch.tensor([0.0, 0.0, -1.0]).expand(480, 640, 3).clone()
    normals[0, 0] = 0.0  # none known
    prepared = prepare(made, {"a": normals}, camera, TrackingConfig())
    found = surface_view(made, prepared, {}, [None], camera, 6.0)
    assert found.sigma.shape == (120, 160)
    assert not found.valid[0, 0]
    assert found.valid[1:].all()
    np.testing.assert_allclose(found.points, 2 * camera.rays()[::4, ::4].numpy(), rtol=1e-5, atol=1e-6)
    u, v, _ = found.camera.project(torch.from_numpy(found.points[7, 9]))
    assert (round(float(u), 3), round(float(v), 3)) == (9.0, 7.0)


def test_readings_are_of_all_sensors_within_reach():
    near, far = image(2.0), image(9.0)
    near[:60] = 0.0
    made = frame(near=near, far=far)
    config = TrackingConfig(depth_samples=300)
    found = sample_depth_points(made, seen(made), [taught(0.02), None], CAMERA, config, 6.0)
    assert 100 < len(found) < 200  # half of about 300, and none of the far ones
    assert (found.points[:, 2] == 2.0).all()
    assert (found.points[:, 1] > 0).all()
    torch.testing.assert_close(found.directions, found.points / 2)
    torch.testing.assert_close(found.beta, torch.full((len(found),), 0.02))
    u, _, _ = CAMERA.project(found.points)
    clear = (u - 79.5).abs() > 4
    torch.testing.assert_close(found.grey[clear], torch.where(u[clear] > 79.5, 200 / 255, 0.0), atol=1e-5, rtol=0)


def test_without_colour_there_are_no_features_and_no_grey():
    made, config = frame(a=image(2.0)), TrackingConfig(color=False)
    assert len(prepare(made, {"a": NORMALS}, CAMERA, config).features) == 0
    assert sample_depth_points(made, {}, [None], CAMERA, config, 6.0).grey is None
    assert len(sample_depth_points(frame(a=image(0.0)), {}, [None], CAMERA, TrackingConfig(), 6.0)) == 0
