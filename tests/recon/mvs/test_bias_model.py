"""Bias of a sensor: learned through noise, accepted only if the views of the sensor then are more consistent."""

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.uncle import UncertaintyConfig
from uncle.recon.mvs.bias_model import BiasModel
from uncle.recon.mvs.bias_validation import ConsistencyTestParameters, CrossViewConsistencyTest, Validation
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS, pixel_inputs, relative_spread
from uncle.recon.sensors.noise_model import Residuals

CONFIG = UncertaintyConfig(batch=1024, learning_rate=0.01)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def smooth(features: torch.Tensor) -> torch.Tensor:
    """The features, of pixels that no edge is near."""
    features[..., SENSOR_INPUTS.index("spread_7")] = -1.5
    return features


def trained_bias(metres: float) -> BiasModel:
    """Trained through noise of 5 cm: measurements at depth input x are `metres` * x too far."""
    features = smooth(torch.randn(20_000, len(SENSOR_INPUTS), generator=generator(1)))
    uniform = torch.rand(20_000, generator=generator(2)) - 0.5
    noise = -0.05 * uniform.sign() * torch.log1p(-2 * uniform.abs())
    bias = BiasModel(CONFIG, generator())
    off = metres * features[:, 0] + noise
    bias.learn(Residuals(off, features, torch.full_like(off, 0.05)), 300, generator())
    return bias


def test_finds_an_offset_below_the_noise():
    bias = trained_bias(0.03)
    fresh = smooth(torch.randn(4000, len(SENSOR_INPUTS), generator=generator(3)))
    found = bias(fresh).detach()
    assert float((found - 0.03 * fresh[:, 0]).abs().median()) < 0.005
    slope = float((found * fresh[:, 0]).mean() / fresh[:, 0].square().mean())
    assert slope == pytest.approx(0.03, rel=0.15)


def test_offset_is_0_unless_active():
    bias, features = trained_bias(0.03), smooth(torch.ones(3, len(SENSOR_INPUTS)))
    assert bias.offset(features) == 0.0
    bias.active.fill_(True)
    assert torch.equal(bias.offset(features), bias(features).detach())
    again = BiasModel(CONFIG, generator(9))
    again.load_state_dict(bias.state_dict())
    assert again.active
    assert torch.equal(again.offset(features), bias.offset(features))


@pytest.mark.parametrize(
    ("beta_m", "voxel_size_m", "exceeds"), [(0.05, 0.1, True), (0.07, 0.1, False), (0.05, 0.05, False)]
)
def test_a_bias_counts_where_it_exceeds_that_of_photometric_depth(beta_m, voxel_size_m, exceeds):
    """It is 2 cm in the median; photometric depth whose beta is a voxel is not used."""
    features = smooth(torch.randn(4000, len(SENSOR_INPUTS), generator=generator(3)))
    nothing = torch.zeros(len(features))
    features[: 6 * len(features) // 10, SENSOR_INPUTS.index("spread_7")] = 1.0  # beside edges, where the bias is 0
    residuals = Residuals(nothing, features, nothing + beta_m)
    assert trained_bias(0.03).exceeds_photometric_bias(residuals, voxel_size_m) == exceeds


def test_corrects_depths_and_leaves_holes():
    bias = trained_bias(0.03)
    depth = torch.tensor([[2.0, 0.0], [1.0, 0.01]])
    features = smooth(torch.zeros(2, 2, len(SENSOR_INPUTS)))
    features[..., 0] = torch.tensor([[1.0, 1.0], [-1.0, 2.0]])
    corrected = bias.correct(depth, features)
    assert float(corrected[0, 0]) == pytest.approx(1.97, abs=0.01)
    assert float(corrected[1, 0]) == pytest.approx(1.03, abs=0.01)
    assert corrected[0, 1] == 0
    assert corrected[1, 1] == 0  # not behind the camera


def test_bias_is_0_at_edges_of_depth():
    """One image with a step of 1 m in its middle."""
    bias = trained_bias(0.03)
    depth = torch.full((40, 60), 2.0)
    depth[:, 30:] = 3.0
    camera = Camera(60, 40, 50.0, 50.0, 29.5, 19.5)
    normals = torch.tensor([0.0, 0.0, -1.0]).expand(40, 60, 3)
    features = pixel_inputs(depth, normals, torch.full((40, 60, 3), 90, dtype=torch.uint8), camera)
    off = bias.image(depth, features)[20]
    assert (off[27:33] == 0).all()
    assert (off[:24] != 0).all()
    assert (off[36:] != 0).all()


def test_the_spread_of_depth_follows_from_the_inputs():
    camera = Camera(60, 40, 50.0, 50.0, 29.5, 19.5)
    depth = torch.full((40, 60), 2.0)
    depth[:, 30:] = 2.5
    normals = torch.tensor([0.0, 0.0, -1.0]).expand(40, 60, 3)
    features = pixel_inputs(depth, normals, torch.full((40, 60, 3), 90, dtype=torch.uint8), camera)
    found = relative_spread(features)[20]
    assert float(found[10]) < 2e-3
    window = 1 / depth[20, 27:34]  # around pixel 30
    assert float(found[30]) == pytest.approx(float(window.std(correction=0) * depth[20, 30]), rel=0.01)


# --- validation --------------------------------------------------------------------------------------------------
def improved_fraction(room, raw, corrected, views: int = 8) -> float | None:
    """The camera walks towards a wall; `raw`, `corrected` are functions of the true depth."""
    test = CrossViewConsistencyTest()
    for step in range(views):
        pose = room.pose(0.05 * step, (1.2 + 0.15 * step, 1.5, 1.2))
        true = torch.from_numpy(room.depth(pose)).float()
        test.add(raw(true), corrected(true), pose)
    return test.improved_fraction(room.camera, seed=0)


def too_far(depth):
    return depth * (1 + 0.02 * depth)


def as_it_is(depth):
    return depth


def test_a_right_correction_improves_all_views(box_room):
    assert improved_fraction(box_room, too_far, as_it_is) == 1.0


def test_a_wrong_correction_improves_no_view(box_room):
    assert improved_fraction(box_room, as_it_is, too_far) == 0.0


def test_half_of_it_still_helps_and_three_times_as_much_does_not(box_room):
    assert improved_fraction(box_room, too_far, lambda d: d * (1 + 0.01 * d)) == 1.0
    assert improved_fraction(box_room, too_far, lambda d: d * (1 - 0.04 * d)) == 0.0


def test_no_correction_improves_no_view(box_room):
    assert improved_fraction(box_room, too_far, too_far) == 0.0


def test_too_few_views_have_no_result(box_room):
    assert improved_fraction(box_room, too_far, as_it_is, views=ConsistencyTestParameters.min_views) is None
    blind = CrossViewConsistencyTest()
    for _ in range(9):
        blind.add(torch.zeros(120, 160), torch.zeros(120, 160), np.eye(4))
    assert blind.improved_fraction(box_room.camera, 0) is None
    assert CrossViewConsistencyTest().improved_fraction(box_room.camera, 0) is None


def test_results_by_fraction_of_improved_views():
    result = ConsistencyTestParameters().result
    assert result(None) is Validation.UNDECIDED
    fractions = {0.0: Validation.REJECTED, 0.25: Validation.REJECTED, 0.5: Validation.UNDECIDED}
    fractions |= {0.75: Validation.ACCEPTED, 1.0: Validation.ACCEPTED}
    assert {fraction: result(fraction) for fraction in fractions} == fractions
