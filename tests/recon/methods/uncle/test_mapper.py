"""The mapper's residuals against a map that really lacks the reading, its weights and its state."""

import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.frame import Frame
from uncle.recon.methods.uncle.mapper import Mapper
from uncle.recon.sensors.fusion_weights import FREE_SPACE_SCALE_BETAS
from uncle.recon.sensors.noise_inputs import FEATURES
from uncle.recon.volume.raycast import cast_rays

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
DEPTHS = (2.0, 2.012, 1.98, 2.025, 1.991)
NORMALS = torch.tensor([0.0, 0.0, -1.0]).expand(60, 80, 3)


def make_mapper(*settings: str, sensors: tuple[str, ...] = ("a",)) -> Mapper:
    quick = ["fusion.voxel_size_m=0.05", "uncertainty.steps_per_keyframe=2", "uncertainty.steps_per_pass=5"]
    config = make_config("uncle", [*quick, "keyframes.rays=500", *settings], sensors=sensors, device="cpu")
    return Mapper(CAMERA, sensors, config, torch.device("cpu"))


def make_frame(index: int, *depths: float, names: tuple[str, ...] = ("a",)) -> Frame:
    images = {name: torch.full((60, 80), depth) for name, depth in zip(names, depths, strict=True)}
    return Frame(index, index, torch.full((60, 80, 3), 90, dtype=torch.uint8), images, torch.eye(4).numpy())


def fuse_all(mapper: Mapper, frames: list[Frame], left_out: int | None = None) -> None:
    for frame in frames:
        mapper.volume.allocate(frame.depths["a"], torch.eye(4))
    for frame in frames:
        if frame.index != left_out:
            mapper.fuse(frame, mapper.features(frame, {"a": NORMALS}), torch.eye(4))


def explore(mapper: Mapper, frame: Frame, pose: torch.Tensor | None = None) -> dict[str, torch.Tensor]:
    """As the pipeline does: features first, then the first look at the frame."""
    features = mapper.features(frame, dict.fromkeys(frame.depths, NORMALS))
    return mapper.explore(frame, features, torch.eye(4) if pose is None else pose)


def hits(mapper: Mapper, rays: dict[str, torch.Tensor]) -> torch.Tensor:
    volume = mapper.volume
    return cast_rays(volume.grid, volume.sdf(), mapper.known(), rays["origins"], rays["directions"], 5.0, 0.1)


def without_itself(mapper, rays, hit, used):
    points = rays["origins"][used] + rays["directions"][used] * hit[used, None]
    own = mapper.weights.of(mapper.noise["a"](rays["features"][used, 0].float()), "a")
    return mapper._without_itself((rays["depths"][used, 0] - hit[used]).abs(), own, points)


@pytest.mark.parametrize("left_out", range(len(DEPTHS)))
def test_residual_is_that_against_a_map_without_the_reading(left_out):
    frames = [make_frame(index, depth) for index, depth in enumerate(DEPTHS)]
    mapper, without = make_mapper(), make_mapper()
    fuse_all(mapper, frames)
    fuse_all(without, frames, left_out)
    frame = frames[left_out]
    rays = mapper._draw_rays(frame, mapper.features(frame, {"a": NORMALS}), torch.eye(4))
    depth, hit, expected = rays["depths"][:, 0], hits(mapper, rays), hits(without, rays)
    used = (hit > 0) & (expected > 0)
    assert used.float().mean() > 0.8
    residual, trusted = without_itself(mapper, rays, hit, used)
    assert trusted.all()
    true = (depth - expected).abs()[used]
    assert float(true.median()) > 0.0015
    assert float((residual - true).abs().median()) < 0.02 * float(true.median()) + 1e-4
    naive = (depth - hit).abs()[used]
    assert float((naive - true).abs().median()) > 0.15 * float(true.median())  # the stretch is what makes it so


def test_a_reading_alone_says_nothing_about_itself():
    mapper = make_mapper("fusion.min_observations=1")
    frame = make_frame(0, 2.0)
    fuse_all(mapper, [frame])
    rays = mapper._draw_rays(frame, mapper.features(frame, {"a": NORMALS}), torch.eye(4))
    hit = hits(mapper, rays)
    assert (hit > 0).float().mean() > 0.8
    used = hit > 0
    _, trusted = without_itself(mapper, rays, hit, used)
    assert not trusted.any()


def test_without_uncertainty_every_reading_weighs_the_same():
    mapper = make_mapper("uncertainty.enabled=false")
    for index, depth in enumerate(DEPTHS[:3]):
        assert explore(mapper, make_frame(index, depth)) == {}
    torch.testing.assert_close(mapper.volume.sums[:, 0], mapper.volume.counts())
    assert (mapper.volume.counts() == 3).any()


def test_learns_which_sensor_lies():
    names = ("good", "bad")
    mapper = make_mapper("uncertainty.steps_per_pass=300", "uncertainty.learning_rate=0.01", sensors=names)
    generator = torch.Generator().manual_seed(0)
    for index in range(8):
        frame = make_frame(index, 2.0, 2.0, names=names)
        noise = torch.rand(60, 80, generator=generator) - 0.5
        frame.depths["bad"].add_(0.1 * noise)
        explore(mapper, frame)
        rays = mapper._draw_rays(frame, mapper.features(frame, dict.fromkeys(names, NORMALS)), torch.eye(4))
        mapper.rays.add(rays, mapper.generator)
    losses = mapper.learn()
    assert losses["good"] < losses["bad"] - 0.5
    features = mapper.features(frame, dict.fromkeys(names, NORMALS))
    beta = {name: mapper.noise[name].beta_image(frame.depths[name], features[name]).mean() for name in names}
    assert beta["good"] < 0.5 * beta["bad"]


def test_without_uncertainty_no_features_are_made():
    frame = make_frame(0, 2.0)
    assert make_mapper("uncertainty.enabled=false").features(frame, {"a": NORMALS}) == {}
    assert make_mapper().features(frame, {"a": NORMALS})["a"].shape == (60, 80, len(FEATURES))


def test_free_space_is_weighted_by_what_the_noise_model_doubts():
    """Every beta is the same on a blank wall: free space gets the reading's weight times 1 - exp(-beyond / 2 beta)."""
    mapper = make_mapper("fusion.discretisation_voxels=0")
    frame = make_frame(0, 2.0)
    mapper.volume.allocate(torch.full((60, 80), 1.0), torch.eye(4))  # blocks far before the wall
    mapper.noise["a"].layers[-1].weight.data.zero_()
    beta = float(explore(mapper, frame)["a"].mean())
    volume = mapper.volume
    z = volume.grid.block_positions(torch.arange(len(volume.grid.blocks))).view(-1, 3)[:, 2]
    beyond = 2.0 - z - volume.truncation_m
    seen = volume.counts() > 0
    full = float(mapper.weights.of(torch.tensor(beta), "a"))
    free = seen & (beyond > 0.01)
    assert free.sum() > 1000
    expected = full * (1 - torch.exp(-beyond[free] / (FREE_SPACE_SCALE_BETAS * beta)))
    torch.testing.assert_close(volume.sums[free, 0], expected, rtol=1e-3, atol=1e-6)
    band = seen & (beyond < -0.01)
    torch.testing.assert_close(volume.sums[band, 0], torch.full_like(z[band], full), rtol=1e-4, atol=0)


def test_frame_without_readings_changes_nothing():
    mapper = make_mapper()
    explore(mapper, make_frame(0, 0.0))
    assert mapper.volume.grid.rows == 0
    explore(mapper, make_frame(1, 2.0))
    before = mapper.volume.sums.clone()
    explore(mapper, make_frame(2, 0.0))
    assert torch.equal(mapper.volume.sums, before)


def test_state_continues_bit_for_bit():
    frames = [make_frame(index, depth) for index, depth in enumerate(DEPTHS)]
    poses = [torch.eye(4) for _ in frames]
    for index, pose in enumerate(poses):
        pose[0, 3] = 0.3 * index  # moves on, so that keyframes are added and learned from
    unbroken, first = make_mapper(), make_mapper()
    for frame, pose in zip(frames[:3], poses[:3], strict=True):
        explore(unbroken, frame, pose)
        explore(first, frame, pose)
    second = make_mapper()
    second.load_state_dict(first.state_dict())
    for mapper in (unbroken, second):
        for frame, pose in zip(frames[3:], poses[3:], strict=True):
            explore(mapper, frame, pose)
        mapper.learn()
    assert torch.equal(unbroken.volume.sums, second.volume.sums)
    assert torch.equal(unbroken.volume.color_sums, second.volume.color_sums)
    assert torch.equal(unbroken.volume.grid.blocks, second.volume.grid.blocks)
    assert torch.equal(unbroken.rays["depths"], second.rays["depths"])
    assert torch.equal(unbroken.generator.get_state(), second.generator.get_state())
    assert len(unbroken.selector.T_camera_world) == len(second.selector.T_camera_world) > 1
    for ours, theirs in zip(unbroken.noise["a"].parameters(), second.noise["a"].parameters(), strict=True):
        assert torch.equal(ours, theirs)


def test_share_of_a_sensor_is_its_part_of_the_weights_around_the_surface():
    """Against the weights that each sensor alone adds to samples within the truncation band."""
    names = ("a", "b")
    both = make_mapper("fusion.voxel_size_m=0.03", sensors=names)
    both.noise["b"].layers[-1].bias.data.add_(1.0)  # another weight
    frame = make_frame(0, 1.515, 2.515, names=names)  # both bands hold 8 layers of samples
    frame.depths["a"][:, 40:] = 0.0  # sees half of the image
    features = both.features(frame, dict.fromkeys(names, NORMALS))
    alone = {}
    for name in names:
        mapper = make_mapper("fusion.voxel_size_m=0.03", sensors=names)
        mapper.noise = both.noise
        only = {other: depth if other == name else depth * 0 for other, depth in frame.depths.items()}
        mapper.volume.allocate(frame.depths[name], torch.eye(4))
        mapper.fuse(Frame(0, 0, frame.color, only, torch.eye(4).numpy()), features, torch.eye(4))
        assert mapper.weight_share()[name] == pytest.approx(1.0)
        near = (mapper.volume.sdf().abs() < mapper.volume.truncation_m - 1e-6) & (mapper.volume.counts() > 0)
        alone[name] = float(mapper.volume.sums[near, 0].sum())
    both.fuse(frame, features, torch.eye(4))
    share = both.weight_share()
    assert sum(share.values()) == pytest.approx(1.0)
    assert share["a"] == pytest.approx(alone["a"] / sum(alone.values()), rel=0.03)
    assert 0.15 < share["a"] < 0.85
    again = make_mapper("fusion.voxel_size_m=0.03", sensors=names)
    again.load_state_dict(both.state_dict())
    assert again.weight_share() == share
    again.clear_volume()
    assert again.weight_share() == {"a": 0.0, "b": 0.0}
    assert not again.volume.sums.any()


def test_share_of_a_frame_that_is_fused_again_counts_once():
    mapper = make_mapper("tracking.enabled=true", "fusion.discretisation_voxels=0")
    frame, moved = make_frame(0, 2.0), torch.eye(4)
    moved[0, 3] = 0.2
    explore(mapper, frame)
    before = dict(mapper.said)
    mapper.refuse(frame, mapper.features(frame, {"a": NORMALS}), moved)
    assert mapper.said["a"] == pytest.approx(before["a"], rel=1e-6)
    assert before["a"] > 0


def test_a_sensor_counts_in_the_map_by_what_its_readings_are_worth():
    names, betas = ("a", "b"), {}
    mapper, again = (make_mapper(sensors=names) for _ in range(2))
    for which, worth in ((mapper, 1.0), (again, 0.25)):
        which.weights.worth["b"] = worth
        betas = explore(which, make_frame(0, 2.0, 2.02, names=names))
    assert all(float(beta.max()) > 0 for beta in betas.values())
    assert again.said["a"] == pytest.approx(mapper.said["a"])
    assert again.said["b"] == pytest.approx(mapper.said["b"] / 4)
    assert make_mapper(sensors=names).weights.worth == {"a": 1.0, "b": 1.0}
    restored = make_mapper(sensors=names)
    restored.load_state_dict(again.state_dict())
    assert restored.weights.worth == {"a": 1.0, "b": 0.25}


def test_readings_are_worth_1_until_colour_is_known_to_be_exact():
    mapper = make_mapper()
    mapper.weights.worth["a"] = 0.2
    mapper.estimate_reliability()
    assert mapper.weights.worth == {"a": 1.0}


def test_fusing_again_is_as_if_the_new_pose_had_been_known():
    """The models learn between the two: the old readings go out with the weights they came in with."""
    frames = [make_frame(index, depth) for index, depth in enumerate(DEPTHS[:3])]
    wrong, right = torch.eye(4), torch.eye(4)
    wrong[:3, 3], right[:3, 3] = torch.tensor([0.15, 0.0, -0.1]), torch.tensor([-0.1, 0.05, 0.1])
    corrected, known = make_mapper("tracking.enabled=true"), make_mapper("tracking.enabled=true")
    for mapper in (corrected, known):
        for pose in (torch.eye(4), wrong, right):
            for frame in frames:
                mapper.volume.allocate(frame.depths["a"], pose)
    features = [corrected.features(frame, {"a": NORMALS}) for frame in frames]
    corrected.explore(frames[0], features[0], torch.eye(4))
    corrected.fuse(frames[1], features[1], wrong)
    corrected.fuse(frames[2], features[2], torch.eye(4))
    old = corrected.noise["a"](features[1]["a"]).detach()
    corrected.learn()
    learned = corrected.noise["a"](features[1]["a"]).detach()
    assert (learned / old - 1).abs().max() > 0.01
    corrected.refuse(frames[1], features[1], right)
    known.fuse(frames[0], features[0], torch.eye(4))
    known.fuse(frames[2], features[2], torch.eye(4))
    known.noise["a"].load_state_dict(corrected.noise["a"].state_dict())
    known.fuse(frames[1], features[1], right)
    assert torch.equal(corrected.volume.grid.blocks, known.volume.grid.blocks)
    assert torch.equal(corrected.volume.counts(), known.volume.counts())
    torch.testing.assert_close(corrected.volume.sums, known.volume.sums, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(corrected.volume.color_sums, known.volume.color_sums, atol=1e-3, rtol=1e-5)
    assert torch.equal(corrected.log.entries[1].T_world_camera, right)


def test_rays_follow_a_frame_that_is_fused_again():
    moved = torch.eye(4)
    moved[:3, :3] = torch.tensor([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    moved[:3, 3] = torch.tensor([1.0, 2.0, 3.0])
    corrected, known = make_mapper("tracking.enabled=true"), make_mapper("tracking.enabled=true")
    frame = make_frame(0, 2.0)
    explore(corrected, frame)
    assert corrected.rays["origins"].is_contiguous()  # rays that share memory cannot be moved in place
    corrected.refuse(frame, corrected.features(frame, {"a": NORMALS}), moved)
    explore(known, frame, moved)
    torch.testing.assert_close(corrected.rays["origins"], known.rays["origins"])
    torch.testing.assert_close(corrected.rays["directions"], known.rays["directions"])
