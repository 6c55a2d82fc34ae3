"""Fusion weights by beta, by image, by sensor reliability, and of photometric depth."""

import torch
from uncle.recon.core.config.uncle import FusionConfig
from uncle.recon.sensors.fusion_weights import FusionWeightParameters, FusionWeights, median_weight

PARAMETERS = FusionWeightParameters()
VALID = torch.tensor([[True, True, True, False]])
BETA = torch.tensor([[1.0, 0.1, 0.05, 0.01]])  # the sharpest is no reading


def weights_of(blur_voxels: float = 0.0) -> FusionWeights:
    return FusionWeights(FusionConfig(voxel_size_m=0.05, discretisation_voxels=blur_voxels), ("a", "b"))


def test_weight_falls_with_the_square_of_beta():
    torch.testing.assert_close(
        weights_of().inverse_variance(torch.tensor([0.01, 0.02, 0.1])), torch.tensor([1.0, 0.25, 0.01])
    )
    torch.testing.assert_close(
        weights_of(1.0).inverse_variance(torch.tensor([0.0, 0.01])), torch.tensor([1 / 25, 1 / 26])
    )


def test_readings_of_an_image_have_a_floor_below_its_typical_one():
    weights = weights_of()
    typical = float(weights.inverse_variance(torch.tensor(0.1)))
    weight, free_space = weights.for_sensor(BETA, VALID, "a")
    torch.testing.assert_close(weight[VALID] / typical, torch.tensor([PARAMETERS.min_relative_weight, 1.0, 4.0]))
    torch.testing.assert_close(
        free_space.weight[VALID] / typical, torch.tensor([PARAMETERS.min_relative_weight, 1.0, 4.0]).sqrt()
    )
    torch.testing.assert_close(free_space.scale_m, PARAMETERS.free_space_scale_betas * BETA)
    assert torch.equal(weights.for_sensor(BETA, torch.zeros_like(VALID), "a")[0], weights.inverse_variance(BETA, "a"))


def test_reliability_scales_all_weights_of_a_sensor():
    weights = weights_of()
    weights.reliability["b"] = 0.25
    (ours, free), (theirs, theirs_free) = (weights.for_sensor(BETA, VALID, sensor) for sensor in ("a", "b"))
    torch.testing.assert_close(theirs, 0.25 * ours)
    torch.testing.assert_close(theirs_free.weight, 0.25 * free.weight)
    torch.testing.assert_close(theirs_free.scale_m, free.scale_m)
    torch.testing.assert_close(weights.inverse_variance(BETA, "b"), 0.25 * weights.inverse_variance(BETA))


def test_photometric_weights_have_no_floor_and_little_free_space():
    weights = weights_of()
    weight, free_space = weights.for_photometric(BETA, VALID, frames=3.0)
    torch.testing.assert_close(weight, 3 * weights.inverse_variance(BETA))
    typical = 3 * weights.inverse_variance(torch.tensor(0.1))
    torch.testing.assert_close(free_space.weight, PARAMETERS.photometric_free_space_factor * (weight * typical).sqrt())


def test_the_typical_weight_is_the_lower_median():
    weight, everything = torch.tensor([[4.0, 1.0], [3.0, 2.0]]), torch.ones(2, 2, dtype=torch.bool)
    assert median_weight(weight, everything) == float(weight.median()) == 2.0
    assert median_weight(weight, ~everything) == 0.0
