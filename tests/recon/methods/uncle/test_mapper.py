"""Integration by the mapper, its weight shares, re-integration, and its state."""

import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.map_config import MapConfig, make_config
from uncle.recon.core.frame import Frame
from uncle.recon.methods.uncle.mapper import Mapper
from uncle.recon.methods.uncle.views import noise_inputs
from uncle.recon.mvs.photometric_samples import PhotometricDepthImage
from uncle.recon.sensors.fusion_weights import FusionWeightParameters
from uncle.recon.sensors.noise_inputs import SENSOR_INPUTS
from uncle.recon.sensors.noise_model import NoiseModel, Residuals

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
DEPTHS = (2.0, 2.012, 1.98, 2.025, 1.991)
NORMALS = torch.tensor([0.0, 0.0, -1.0]).expand(60, 80, 3)


def make_settings(*settings: str, sensors: tuple[str, ...] = ("a",)) -> MapConfig:
    return make_config("uncle", ["fusion.voxel_size_m=0.05", *settings], sensors=sensors, device="cpu")


def make_mapper(*settings: str, sensors: tuple[str, ...] = ("a",)) -> Mapper:
    config, generator = make_settings(*settings, sensors=sensors), torch.Generator().manual_seed(0)
    noise = {sensor: NoiseModel(config.uncertainty, generator) for sensor in sensors}
    return Mapper(CAMERA, sensors, config, noise, torch.device("cpu"))


def make_frame(index: int, *depths: float, names: tuple[str, ...] = ("a",)) -> Frame:
    images = {name: torch.full((60, 80), depth) for name, depth in zip(names, depths, strict=True)}
    return Frame(index, index, torch.full((60, 80, 3), 90, dtype=torch.uint8), images, torch.eye(4).numpy())


def inputs_of(frame: Frame) -> dict[str, torch.Tensor]:
    return noise_inputs(frame, dict.fromkeys(frame.depths, NORMALS), CAMERA)


def integrate(mapper: Mapper, frame: Frame, pose: torch.Tensor | None = None) -> None:
    pose = torch.eye(4) if pose is None else pose
    mapper.allocate(frame, pose)
    mapper.integrate(frame, inputs_of(frame), pose)


def test_without_uncertainty_every_measurement_weighs_the_same():
    mapper = make_mapper("uncertainty.enabled=false")
    assert mapper.is_empty
    for index, depth in enumerate(DEPTHS[:3]):
        frame = make_frame(index, depth)
        mapper.allocate(frame, torch.eye(4))
        mapper.integrate(frame, {}, torch.eye(4))
    assert not mapper.is_empty
    torch.testing.assert_close(mapper.volume.sums[:, 0], mapper.volume.counts())
    assert (mapper.volume.counts() == 3).any()


def test_noise_inputs_are_made_for_every_sensor():
    inputs = inputs_of(make_frame(0, 2.0, 2.1, names=("a", "b")))
    assert {sensor: image.shape for sensor, image in inputs.items()} == dict.fromkeys(
        "ab", (60, 80, len(SENSOR_INPUTS))
    )


def test_the_surface_follows_every_change_of_the_map():
    """It is cached, and must not outlive what it was made of."""
    mapper = make_mapper("fusion.min_observations=1", "tracking.enabled=true")
    ray = torch.tensor([[0.0, 0.0, 1.0]])

    def depth() -> float:
        return float(mapper.surface().depth_along_rays(ray, torch.eye(4)))

    frame, moved = make_frame(0, 2.0), torch.eye(4)
    integrate(mapper, frame)
    assert depth() == pytest.approx(2.0, abs=0.01)
    moved[2, 3] = 0.1
    mapper.reintegrate(frame, inputs_of(frame), moved)
    assert depth() == pytest.approx(2.1, abs=0.01)
    mapper.clear_volume()
    assert depth() == 0.0


def test_free_space_is_weighted_on_the_scale_of_beta():
    """Every beta is the same on a blank wall: free space gets the weight times 1 - exp(-distance / 2 beta)."""
    mapper = make_mapper("fusion.discretisation_voxels=0")
    frame = make_frame(0, 2.0)
    mapper.volume.allocate(torch.full((60, 80), 1.0), torch.eye(4))  # blocks far in front of the wall
    mapper.noise["a"].layers[-1].weight.data.zero_()
    integrate(mapper, frame)
    beta = float(mapper.noise["a"].beta_image(frame.depths["a"], inputs_of(frame)["a"]).mean())
    volume = mapper.volume
    z = volume.grid.block_positions(torch.arange(len(volume.grid.blocks))).view(-1, 3)[:, 2]
    distance = 2.0 - z - volume.truncation_m
    observed = volume.counts() > 0
    full = float(mapper.weights.inverse_variance(torch.tensor(beta), "a"))
    free = observed & (distance > 0.01)
    assert free.sum() > 1000
    expected = full * (1 - torch.exp(-distance[free] / (FusionWeightParameters().free_space_scale_betas * beta)))
    torch.testing.assert_close(volume.sums[free, 0], expected, rtol=1e-3, atol=1e-6)
    band = observed & (distance < -0.01)
    torch.testing.assert_close(volume.sums[band, 0], torch.full_like(z[band], full), rtol=1e-4, atol=0)


def test_a_frame_without_measurements_changes_nothing():
    mapper = make_mapper()
    integrate(mapper, make_frame(0, 0.0))
    assert mapper.is_empty
    integrate(mapper, make_frame(1, 2.0))
    before = mapper.volume.sums.clone()
    integrate(mapper, make_frame(2, 0.0))
    assert torch.equal(mapper.volume.sums, before)


def test_state_continues_bit_for_bit():
    frames = [make_frame(index, depth) for index, depth in enumerate(DEPTHS)]
    poses = [torch.eye(4) for _ in frames]
    for index, pose in enumerate(poses):
        pose[0, 3] = 0.3 * index
    unbroken, first = make_mapper("tracking.enabled=true"), make_mapper("tracking.enabled=true")
    for frame, pose in zip(frames[:3], poses[:3], strict=True):
        integrate(unbroken, frame, pose)
        integrate(first, frame, pose)
    second = make_mapper("tracking.enabled=true")
    second.load_state_dict(first.state_dict())
    for mapper in (unbroken, second):
        for frame, pose in zip(frames[3:], poses[3:], strict=True):
            integrate(mapper, frame, pose)
        mapper.reintegrate(frames[1], inputs_of(frames[1]), poses[2])
    assert torch.equal(unbroken.volume.sums, second.volume.sums)
    assert torch.equal(unbroken.volume.color_sums, second.volume.color_sums)
    assert torch.equal(unbroken.volume.grid.blocks, second.volume.grid.blocks)
    assert unbroken.weight_sums.sums == second.weight_sums.sums


def test_weight_share_of_a_sensor_is_its_part_of_the_weights_around_the_surface():
    """Against the weights that each sensor alone adds to samples within the truncation band."""
    names = ("a", "b")
    both = make_mapper("fusion.voxel_size_m=0.03", sensors=names)
    both.noise["b"].layers[-1].bias.data.add_(1.0)  # another weight
    frame = make_frame(0, 1.515, 2.515, names=names)  # both bands hold 8 layers of samples
    frame.depths["a"][:, 40:] = 0.0  # sees half of the image
    inputs = inputs_of(frame)
    alone = {}
    for name in names:
        mapper = make_mapper("fusion.voxel_size_m=0.03", sensors=names)
        mapper.noise = both.noise
        only = {other: depth if other == name else depth * 0 for other, depth in frame.depths.items()}
        mapper.volume.allocate(frame.depths[name], torch.eye(4))
        mapper.integrate(Frame(0, 0, frame.color, only, torch.eye(4).numpy()), inputs, torch.eye(4))
        assert mapper.weight_sums.shares()[name] == pytest.approx(1.0)
        near = (mapper.volume.sdf().abs() < mapper.volume.truncation_m - 1e-6) & (mapper.volume.counts() > 0)
        alone[name] = float(mapper.volume.sums[near, 0].sum())
    both.integrate(frame, inputs, torch.eye(4))
    share = both.weight_sums.shares()
    assert sum(share.values()) == pytest.approx(1.0)
    assert share["a"] == pytest.approx(alone["a"] / sum(alone.values()), rel=0.03)
    assert 0.15 < share["a"] < 0.85
    again = make_mapper("fusion.voxel_size_m=0.03", sensors=names)
    again.load_state_dict(both.state_dict())
    assert again.weight_sums.shares() == share
    again.clear_volume()
    assert again.weight_sums.shares() == {"a": 0.0, "b": 0.0}
    assert not again.volume.sums.any()


def test_weight_share_counts_a_reintegrated_frame_once():
    mapper = make_mapper("tracking.enabled=true", "fusion.discretisation_voxels=0")
    frame, moved = make_frame(0, 2.0), torch.eye(4)
    moved[0, 3] = 0.2
    integrate(mapper, frame)
    before = mapper.weight_sums.sums["a"]
    mapper.reintegrate(frame, inputs_of(frame), moved)
    assert mapper.weight_sums.sums["a"] == pytest.approx(before, rel=1e-6)
    assert before > 0


def test_a_sensor_counts_in_the_map_by_its_reliability():
    names = ("a", "b")
    mapper, again = (make_mapper(sensors=names) for _ in range(2))
    for which, reliability in ((mapper, 1.0), (again, 0.25)):
        which.weights.reliability["b"] = reliability
        integrate(which, make_frame(0, 2.0, 2.02, names=names))
    assert again.weight_sums.sums["a"] == pytest.approx(mapper.weight_sums.sums["a"])
    assert again.weight_sums.sums["b"] == pytest.approx(mapper.weight_sums.sums["b"] / 4)
    assert make_mapper(sensors=names).weights.reliability == {"a": 1.0, "b": 1.0}
    restored = make_mapper(sensors=names)
    restored.load_state_dict(again.state_dict())
    assert restored.weights.reliability == {"a": 1.0, "b": 0.25}


def test_reintegration_is_as_if_the_new_pose_had_been_known():
    """The models are trained in between: the frame is subtracted with the weights that it was added with."""
    frames = [make_frame(index, depth) for index, depth in enumerate(DEPTHS[:3])]
    wrong, right = torch.eye(4), torch.eye(4)
    wrong[:3, 3], right[:3, 3] = torch.tensor([0.15, 0.0, -0.1]), torch.tensor([-0.1, 0.05, 0.1])
    corrected, known = make_mapper("tracking.enabled=true"), make_mapper("tracking.enabled=true")
    for mapper in (corrected, known):
        for pose in (torch.eye(4), wrong, right):
            for frame in frames:
                mapper.volume.allocate(frame.depths["a"], pose)
    inputs = [inputs_of(frame) for frame in frames]
    corrected.integrate(frames[0], inputs[0], torch.eye(4))
    corrected.integrate(frames[1], inputs[1], wrong)
    corrected.integrate(frames[2], inputs[2], torch.eye(4))
    model, pixels = corrected.noise["a"], inputs[1]["a"].reshape(-1, len(SENSOR_INPUTS))
    old = model(pixels).detach()
    model.learn(
        Residuals.from_exact_reference(torch.full((len(pixels),), 0.01), pixels), 30, torch.Generator().manual_seed(1)
    )
    assert (model(pixels).detach() / old - 1).abs().max() > 0.01
    corrected.reintegrate(frames[1], inputs[1], right)
    known.integrate(frames[0], inputs[0], torch.eye(4))
    known.integrate(frames[2], inputs[2], torch.eye(4))
    known.noise["a"].load_state_dict(model.state_dict())
    known.integrate(frames[1], inputs[1], right)
    assert torch.equal(corrected.volume.grid.blocks, known.volume.grid.blocks)
    assert torch.equal(corrected.volume.counts(), known.volume.counts())
    torch.testing.assert_close(corrected.volume.sums, known.volume.sums, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(corrected.volume.color_sums, known.volume.color_sums, atol=1e-3, rtol=1e-5)
    assert torch.equal(corrected.log.records[1].T_world_camera, right)


def test_a_view_weighs_as_much_as_the_frames_it_stands_for(box_room, walk):
    """Fused alone: each sample holds frames_per_view times the weight of beta, and the surface lies at the
    depth of the view."""
    config = make_config("uncle", ["fusion.voxel_size_m=0.05", "fusion.discretisation_voxels=1"], device="cpu")
    mapper = Mapper(box_room.camera, ("stereo",), config, {}, torch.device("cpu"))
    depth = torch.full((120, 160), 2.0)
    image = PhotometricDepthImage(depth, torch.full_like(depth, 0.0625), torch.eye(4))
    mapper.integrate_photometric([image, image], frames_per_view=7.0)
    volume = mapper.volume
    positions = volume.grid.block_positions(torch.arange(len(volume.grid.blocks))).view(-1, 3)
    near = ((positions[:, 2] - 2.0).abs() < 0.1) & (volume.counts() == 2)
    assert near.sum() > 1000
    expected = 2 * 7 * mapper.weights.inverse_variance(torch.tensor(0.0625))
    torch.testing.assert_close(volume.sums[near, 0], expected.expand(int(near.sum())), rtol=1e-4, atol=0)
    torch.testing.assert_close(volume.sdf()[near], 2.0 - positions[near, 2], atol=1e-4, rtol=0)
    assert not volume.color_sums.any()
    assert mapper.weight_sums.shares() == {"stereo": 0.0}
