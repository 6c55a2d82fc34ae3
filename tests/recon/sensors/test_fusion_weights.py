"""What readings weigh: by beta, by their image, by their sensor, and as colour."""

import torch
from uncle.recon.core.config.uncle import FusionConfig
from uncle.recon.sensors.fusion_weights import (
    FREE_SPACE_SCALE_BETAS,
    MIN_RELATIVE_WEIGHT,
    PHOTOMETRIC_FREE_SPACE_FACTOR,
    FusionWeights,
    median_weight,
)

VALID = torch.tensor([[True, True, True, False]])
BETA = torch.tensor([[1.0, 0.1, 0.05, 0.01]])  # the sharpest is no reading


def weights_of(blur_voxels: float = 0.0) -> FusionWeights:
    return FusionWeights(FusionConfig(voxel_size_m=0.05, discretisation_voxels=blur_voxels), ("a", "b"))


def test_weight_falls_with_the_square_of_beta():
    torch.testing.assert_close(weights_of().of(torch.tensor([0.01, 0.02, 0.1])), torch.tensor([1.0, 0.25, 0.01]))
    torch.testing.assert_close(weights_of(1.0).of(torch.tensor([0.0, 0.01])), torch.tensor([1 / 25, 1 / 26]))


def test_readings_of_an_image_have_a_floor_below_its_typical_one():
    weights = weights_of()
    typical = float(weights.of(torch.tensor(0.1)))
    weight, free_space = weights.of_image(BETA, VALID, "a")
    torch.testing.assert_close(weight[VALID] / typical, torch.tensor([MIN_RELATIVE_WEIGHT, 1.0, 4.0]))
    torch.testing.assert_close(free_space.weight[VALID] / typical, torch.tensor([MIN_RELATIVE_WEIGHT, 1.0, 4.0]).sqrt())
    torch.testing.assert_close(free_space.scale_m, FREE_SPACE_SCALE_BETAS * BETA)
    assert torch.equal(weights.of_image(BETA, torch.zeros_like(VALID), "a")[0], weights.of(BETA, "a"))


def test_what_a_sensor_is_worth_scales_all_that_it_says():
    weights = weights_of()
    weights.worth["b"] = 0.25
    (ours, free), (theirs, theirs_free) = (weights.of_image(BETA, VALID, sensor) for sensor in ("a", "b"))
    torch.testing.assert_close(theirs, 0.25 * ours)
    torch.testing.assert_close(theirs_free.weight, 0.25 * free.weight)
    torch.testing.assert_close(theirs_free.scale_m, free.scale_m)
    torch.testing.assert_close(weights.of(BETA, "b"), 0.25 * weights.of(BETA))


def test_a_view_of_colour_has_no_floor_and_says_little_about_free_space():
    weights = weights_of()
    weight, free_space = weights.of_color(BETA, VALID, frames=3.0)
    torch.testing.assert_close(weight, 3 * weights.of(BETA))
    typical = 3 * weights.of(torch.tensor(0.1))
    torch.testing.assert_close(free_space.weight, PHOTOMETRIC_FREE_SPACE_FACTOR * (weight * typical).sqrt())


def test_the_typical_weight_is_the_lower_median():
    weight, everything = torch.tensor([[4.0, 1.0], [3.0, 2.0]]), torch.ones(2, 2, dtype=torch.bool)
    assert median_weight(weight, everything) == float(weight.median()) == 2.0
    assert median_weight(weight, ~everything) == 0.0
