"""The network h_w on noise whose scale is known."""

import copy
import math

import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.config.uncle import UncertaintyConfig
from uncle.recon.core.errors import ConfigError
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS
from uncle.recon.sensors.noise_model import PIXELS, START_BETA_M, NoiseModel, Residuals, input_mask

SCALES = (0.01, 0.06)  # metres: of readings whose first feature is -1 and +1


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def draw(count: int, scales: tuple[float, float] = SCALES) -> tuple[torch.Tensor, torch.Tensor]:
    """Features (N, F) and Laplace residuals (N,) whose scale follows the first feature."""
    features = torch.randn(count, len(SENSOR_INPUTS), generator=generator(1)) * 0.5
    features[:, 0] = torch.randint(2, (count,), generator=generator(2)) * 2.0 - 1
    beta = torch.where(features[:, 0] > 0, scales[1], scales[0])
    uniform = torch.rand(count, generator=generator(3)) - 0.5
    return features, -beta * uniform.sign() * torch.log1p(-2 * uniform.abs())


def test_learns_a_noise_of_two_levels():
    features, residuals = draw(40_000)
    model = NoiseModel(UncertaintyConfig(batch=2048), generator())
    loss = model.learn(Residuals.from_exact_reference(residuals, features), 400, generator())
    fresh = draw(4000)[0]
    beta = model(fresh).detach()
    for sign, scale in zip((-1, 1), SCALES, strict=True):
        assert float(beta[fresh[:, 0] == sign].median()) == pytest.approx(scale, rel=0.12)
    entropy = 1 + sum(math.log(2 * scale) for scale in SCALES) / 2  # of the noise itself: the best that can be had
    assert loss == pytest.approx(entropy, abs=0.1)


def test_starts_alike_everywhere():
    beta = NoiseModel(UncertaintyConfig(), generator())(draw(500)[0]).detach()
    assert float(beta.mean()) == pytest.approx(START_BETA_M, rel=0.2)
    assert float(beta.max() / beta.min()) < 2


def test_beta_is_never_below_its_minimum():
    config = UncertaintyConfig(beta_min_m=0.02, batch=256, learning_rate=0.05)
    model = NoiseModel(config, generator())
    features, residuals = draw(2000, (1e-5, 1e-5))
    model.learn(Residuals.from_exact_reference(residuals, features), 100, generator())
    beta = model(features).detach()
    assert float(beta.min()) >= 0.02 - 1e-8
    assert float(beta.max()) < 0.03


def test_same_seed_same_model():
    features, residuals = draw(3000)
    models = []
    for seed in (5, 5, 6):
        model = NoiseModel(UncertaintyConfig(batch=256), generator(seed))
        model.learn(Residuals.from_exact_reference(residuals, features), 20, generator(seed))
        models.append(model(features).detach())
    assert torch.equal(models[0], models[1])
    assert not torch.equal(models[0], models[2])


def test_nothing_to_learn_from():
    model = NoiseModel(UncertaintyConfig(), generator())
    before = [values.clone() for values in model.state_dict().values()]
    assert math.isnan(
        model.learn(Residuals.from_exact_reference(torch.zeros(0), torch.zeros(0, len(SENSOR_INPUTS))), 10, generator())
    )
    assert all(torch.equal(a, b) for a, b in zip(before, model.state_dict().values(), strict=True))


def test_beta_image_is_the_network_where_there_is_depth():
    model = NoiseModel(UncertaintyConfig(), generator())
    height, width = 260, PIXELS // 256  # more pixels than are evaluated at a time
    features = torch.randn(height, width, len(SENSOR_INPUTS), generator=generator(4))
    depth = (torch.rand(height, width, generator=generator(5)) > 0.3).float() * 2
    beta = model.beta_image(depth, features)
    assert beta.shape == depth.shape
    assert torch.equal(beta == 0, depth == 0)
    torch.testing.assert_close(beta[depth > 0], model(features)[depth > 0].detach())
    assert (model.beta_image(torch.zeros(4, 5), features[:4, :5]) == 0).all()


def test_inputs_that_are_not_named_are_not_seen():
    config = make_config("uncle", ['uncertainty.inputs=["depth", "holes_3"]']).uncertainty
    model = NoiseModel(config, generator())
    features = torch.rand(500, len(SENSOR_INPUTS), generator=generator(5))
    model.learn(
        Residuals.from_exact_reference(features[:, SENSOR_INPUTS.index("image_x")], features), 20, generator()
    )  # the hidden input would explain most
    seen = [SENSOR_INPUTS.index(name) for name in ("depth", "holes_3")]
    others = features.clone()
    others[:, [column for column in range(len(SENSOR_INPUTS)) if column not in seen]] = 9.0
    assert torch.equal(model(features), model(others))
    assert model(features).std() > 0
    others[:, seen] += 1.0
    assert not torch.equal(model(features), model(others))


def test_inputs_without_a_name_are_all_seen_and_unknown_ones_refused():
    assert input_mask(SENSOR_INPUTS, ()).eq(1).all()
    assert input_mask(SENSOR_INPUTS, SENSOR_INPUTS).eq(1).all()
    with pytest.raises(ConfigError, match="no input is called 'dept'; known inputs: depth, incidence"):
        input_mask(SENSOR_INPUTS, ("dept",))


def test_inputs_with_names_of_their_own_are_all_used():
    config = make_config("uncle", ['uncertainty.inputs=["depth"]']).uncertainty
    assert NoiseModel(config, generator()).used_inputs == ["depth"]
    assert NoiseModel(config, generator(), ("peak", "ratio")).used_inputs == ["peak", "ratio"]


def test_is_trained_is_part_of_the_state():
    features, residuals = draw(300)
    model, later = (NoiseModel(UncertaintyConfig(batch=64), generator(seed)) for seed in (0, 1))
    assert not model.is_trained
    model.learn(Residuals.from_exact_reference(residuals[:0], features[:0]), 5, generator())
    assert not model.is_trained
    model.learn(Residuals.from_exact_reference(residuals, features), 5, generator())
    assert model.is_trained
    later.load_training_state(copy.deepcopy(model.training_state()))
    assert later.is_trained
    for network in (model, later):
        network.learn(Residuals.from_exact_reference(residuals, features), 5, generator(3))
    assert torch.equal(model(features), later(features))


def test_residuals_in_order():
    first = Residuals.from_exact_reference(torch.tensor([1.0, -2.0]), torch.zeros(2, 3))
    second = Residuals(torch.tensor([3.0]), torch.ones(1, 3), torch.tensor([0.5]))
    joined = first.concatenate(second)
    assert joined.metres.tolist() == [1.0, -2.0, 3.0]
    assert joined.reference_scale.tolist() == [0.0, 0.0, 0.5]
    assert joined.inputs[:, 0].tolist() == [0.0, 0.0, 1.0]


def test_normalised_residuals_are_absolute_and_in_betas():
    model = NoiseModel(UncertaintyConfig(), generator())
    features, residuals = draw(50)
    expected = (residuals.abs() / model(features)).detach().numpy()
    assert model.normalised(Residuals.from_exact_reference(residuals, features)) == pytest.approx(expected)
