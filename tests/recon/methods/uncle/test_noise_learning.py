"""Training of the noise models: leave-one-out residuals against a map that really lacks the measurement."""

import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.config.uncle import KeyframeConfig
from uncle.recon.core.frame import Frame
from uncle.recon.methods.uncle.mapper import Mapper
from uncle.recon.methods.uncle.noise_learning import MapEvidence, NoiseLearner, leave_one_out, map_residuals
from uncle.recon.methods.uncle.ray_buffer import RayBuffer, Rays
from uncle.recon.methods.uncle.views import noise_inputs
from uncle.recon.mvs.bias_model import BiasModel
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
CPU = torch.device("cpu")
DEPTHS = (2.0, 2.012, 1.98, 2.025, 1.991)
NORMALS = torch.tensor([0.0, 0.0, -1.0]).expand(60, 80, 3)


def make_frame(index: int, *depths: float, names: tuple[str, ...] = ("a",)) -> Frame:
    images = {name: torch.full((60, 80), depth) for name, depth in zip(names, depths, strict=True)}
    return Frame(index, index, torch.full((60, 80, 3), 90, dtype=torch.uint8), images, torch.eye(4).numpy())


class Scene:
    """A mapper with its learner; frames are all taken from the origin."""

    def __init__(self, *settings: str, sensors: tuple[str, ...] = ("a",)) -> None:
        config = make_config("uncle", ["fusion.voxel_size_m=0.05", *settings], sensors=sensors, device="cpu")
        self.generator = torch.Generator().manual_seed(0)
        self.learner = NoiseLearner(sensors, config.uncertainty, self.generator, CPU)
        self.mapper = Mapper(CAMERA, sensors, config, self.learner.models, CPU)
        self.biases = {sensor: BiasModel(config.uncertainty, self.generator) for sensor in sensors}
        self.buffer = RayBuffer(CAMERA, sensors, KeyframeConfig(rays=500), 6.0)

    def inputs(self, frame: Frame) -> dict[str, torch.Tensor]:
        return noise_inputs(frame, dict.fromkeys(frame.depths, NORMALS), CAMERA)

    def integrate(self, frames: list[Frame], left_out: int | None = None) -> None:
        for frame in frames:
            self.mapper.allocate(frame, torch.eye(4))
        for frame in frames:
            if frame.index != left_out:
                self.mapper.integrate(frame, self.inputs(frame), torch.eye(4))

    def draw(self, frame: Frame) -> Rays:
        return self.buffer.draw(frame, self.inputs(frame), torch.eye(4), self.generator)

    def map_depth(self, rays: Rays) -> torch.Tensor:
        return self.mapper.surface().raycast(rays.origins, rays.directions)

    def left_out(self, rays: Rays):
        residuals = map_residuals(rays, "a", self.map_depth(rays), self.biases["a"])
        beta = self.learner.models["a"](residuals.inputs.float())
        weights = self.mapper.weights.inverse_variance(beta, "a")
        return residuals, leave_one_out(residuals, weights, self.mapper.volume)


@pytest.mark.parametrize("left_out", range(len(DEPTHS)))
def test_residual_is_that_against_a_map_without_the_measurement(left_out):
    frames = [make_frame(index, depth) for index, depth in enumerate(DEPTHS)]
    scene, without = Scene(), Scene()
    scene.integrate(frames)
    without.integrate(frames, left_out)
    rays = scene.draw(frames[left_out])
    both = (scene.map_depth(rays) > 0) & (without.map_depth(rays) > 0)
    assert both.float().mean() > 0.8
    rays = rays.at(both.nonzero()[:, 0])
    plain, residuals = scene.left_out(rays)
    assert len(residuals.corrected) == len(rays)  # all of them can be known
    true = (rays.depths[:, 0] - without.map_depth(rays)).abs()
    assert float(true.median()) > 0.0015
    assert float((residuals.corrected.abs() - true).abs().median()) < 0.02 * float(true.median()) + 1e-4
    # The plain residual is too small: the measurement has pulled the map towards itself.
    assert float((plain.corrected.abs() - true).abs().median()) > 0.15 * float(true.median())


def test_a_measurement_alone_has_no_residual():
    scene, frame = Scene("fusion.min_observations=1"), make_frame(0, 2.0)
    scene.integrate([frame])
    rays = scene.draw(frame)
    plain, residuals = scene.left_out(rays)
    assert len(plain.corrected) > 0.8 * len(rays)
    assert len(residuals.corrected) == 0


def test_the_raw_target_includes_the_bias():
    scene, frames = Scene(), [make_frame(index, 2.0) for index in range(3)]
    scene.integrate(frames)
    rays = scene.draw(frames[0])
    scene.biases["a"].active.fill_(True)
    scene.biases["a"].layers[-1].bias.data[1] = 0.3  # 3 cm
    residuals = map_residuals(rays, "a", scene.map_depth(rays), scene.biases["a"])
    raw, corrected = residuals.to_target("raw"), residuals.to_target("corrected")
    assert float(residuals.bias.mean()) == pytest.approx(0.03, abs=0.01)
    torch.testing.assert_close(raw.metres - corrected.metres, residuals.bias)
    assert float(raw.metres.abs().median()) < 0.002


def test_learns_which_sensor_is_noisy():
    names = ("good", "bad")
    scene = Scene(
        "uncertainty.steps_per_pass=300", "uncertainty.learning_rate=0.01", "uncertainty.steps_per_keyframe=2",
        sensors=names,
    )  # fmt: skip
    generator = torch.Generator().manual_seed(0)
    for index in range(8):
        frame = make_frame(index, 2.0, 2.0, names=names)
        frame.depths["bad"].add_(0.1 * (torch.rand(60, 80, generator=generator) - 0.5))
        rays = scene.draw(frame)
        if index > 0:
            scene.learner.learn_online(rays, scene.map_depth(rays), scene.biases)
        scene.buffer.add(rays, scene.generator)
        scene.integrate([frame])
    rays = scene.buffer.rays
    evidence = MapEvidence(
        rays, scene.map_depth(rays), scene.mapper.volume, scene.mapper.weights, scene.biases, None
    )  # fmt: skip
    losses = scene.learner.learn_from_map(evidence, target="corrected")
    assert losses["good"] < losses["bad"] - 0.5
    assert not scene.learner.error_quantiles
    models, inputs = scene.learner.models, scene.inputs(frame)
    beta = {name: models[name].beta_image(frame.depths[name], inputs[name]).mean() for name in names}
    assert beta["good"] < 0.5 * beta["bad"]
    scene.learner.learn_from_map(evidence, target="raw")
    assert set(scene.learner.error_quantiles) == set(names)
    restored = NoiseLearner(names, scene.learner.config, torch.Generator(), CPU)
    restored.load_state_dict(scene.learner.state_dict())
    pixels = torch.rand(5, len(SENSOR_INPUTS))
    assert torch.equal(restored.models["bad"](pixels), models["bad"](pixels))
    assert restored.error_quantiles == scene.learner.error_quantiles
