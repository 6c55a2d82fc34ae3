"""Colour as a sensor of the map: what it corrects, how sure it is, and when it has nothing to say."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.config.uncle import PhotometricConfig, UncertaintyConfig
from uncle.recon.core.events import Progress
from uncle.recon.core.frame import Frame
from uncle.recon.core.mesh_raycaster import Surface
from uncle.recon.methods.uncle import pipeline
from uncle.recon.methods.uncle.mapper import Mapper
from uncle.recon.methods.uncle.ray_batch import RayBatch
from uncle.recon.mvs.bias_model import CONFIRMED, REFUTED, BiasModel, CrossViewConsistencyTest
from uncle.recon.mvs.photometric_depth import FULL_SIZE_PIXELS, PhotometricDepth
from uncle.recon.mvs.plane_sweep import MIN_SOURCES
from uncle.recon.mvs.sensor_reliability import DEFAULT_RELIABILITY
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.frames import RunFrames

STEPS = UncertaintyConfig(steps_per_pass=150, learning_rate=0.01)
VOXEL_M = 0.05
QUICK = [
    "fusion.voxel_size_m=0.05", "fusion.min_observations=2", "keyframes.rays=500", "field.iterations=0",
    "uncertainty.steps_per_keyframe=4", "uncertainty.steps_per_pass=120", "uncertainty.learning_rate=0.01",
]  # fmt: skip


class RoomFrames(RunFrames):
    """The painted room in memory; its one sensor reads `scale` times the true depth. `paint` goes to the pictures."""

    registration_sigma_px = 0.0

    def __init__(self, room, poses, scale: float = 1.0, grain: float = 0.0, **paint) -> None:
        self.room, self.poses, self.scale, self.camera, self.sensors = room, poses, scale, room.camera, ("stereo",)
        rng = np.random.default_rng(0)
        pictures = [room.picture(pose, **paint) + rng.normal(0, grain, (*self._size, 1)) for pose in poses]
        self.colors = [torch.from_numpy(np.rint(p).clip(0, 255).astype(np.uint8)) for p in pictures]

    @property
    def _size(self) -> tuple[int, int]:
        return self.camera.height, self.camera.width

    def color(self, index):
        return self.colors[index]

    def normals(self, index, sensor):
        return torch.from_numpy(self.room.normals(self.poses[index]))

    def __getitem__(self, index):
        depth = torch.from_numpy(self.room.depth(self.poses[index]) * self.scale).float()
        return Frame(index, index, self.colors[index], {"stereo": depth}, self.poses[index])


class OffSurface:
    """A map whose depth is `scale` times that of the room."""

    def __init__(self, room, scale: float) -> None:
        self.room, self.scale = room, scale

    def depth_from(self, camera, T_world_camera):
        return (replace(self.room, camera=camera).depth(T_world_camera) * self.scale).astype(np.float32)

    def median_depth(self, camera, T_world_camera):
        return float(np.median(self.depth_from(camera, T_world_camera)))


class RoomSurface:
    """The room as a map, along rays of whole pixels."""

    def __init__(self, room) -> None:
        self.room = room

    def along(self, rays, T_world_camera):
        u, v, _ = self.room.camera.project(rays)
        depth = torch.from_numpy(self.room.depth(T_world_camera.numpy().astype(np.float64))).float()
        return depth[v.round().long(), u.round().long()]


@pytest.fixture(scope="module")
def walk(box_room) -> list[np.ndarray]:
    """Before two walls and the corner between them."""
    return [
        box_room.pose(angle, (1.6 + 0.3 * np.sin(i), 0.9 + 0.3 * i, 1.0 + 0.15 * (i % 3)))
        for i in range(5)
        for angle in (0.0, 0.35)
    ]


def witness_of(room, walk, scale=1.04, config=None, **paint) -> tuple[PhotometricDepth, float | None]:
    frames = RoomFrames(room, walk, **paint)
    witness = PhotometricDepth(room.camera, config or PhotometricConfig(), STEPS, VOXEL_M, seed=0)
    return witness, witness.look(frames, dict(enumerate(walk)), OffSurface(room, scale))


def heights(room, pose) -> np.ndarray:
    """(H, W) of what is seen above the floor, metres."""
    return (room.camera.rays().numpy() @ pose[:3, :3].T)[..., 2] * room.depth(pose) + pose[2, 3]


# --- what it says ------------------------------------------------------------------------------------------------
def test_readings_are_nearer_to_the_truth_than_the_map(box_room, walk):
    witness, loss = witness_of(box_room, walk)
    readings = list(witness.readings())
    assert len(readings) == len(walk)
    assert np.isfinite(loss)
    assert witness.frames_per_view == 1.0
    for (depth, beta, pose), true_pose in zip(readings, walk, strict=True):
        assert depth.shape == beta.shape == (box_room.camera.height, box_room.camera.width)
        np.testing.assert_allclose(pose.numpy(), true_pose, atol=1e-6)
        true, found = box_room.depth(true_pose), (depth > 0).numpy()
        assert found.mean() > 0.7
        assert np.median(np.abs(depth.numpy() / true - 1)[found]) < 0.004  # the map: 0.04
        assert ((beta > 0).numpy() == found).all()


def test_beta_is_large_where_nothing_is_painted(box_room, walk):
    witness, _ = witness_of(box_room, walk, grain=1.0, blank_above_m=1.25)
    painted, blank, off_blank = [], [], []
    for (depth, beta, _), pose in zip(witness.readings(), walk, strict=True):
        height, found = heights(box_room, pose), depth.numpy() > 0
        painted.append(beta.numpy()[found & (height < 1.0)])
        blank.append(beta.numpy()[found & (height > 1.5)])
        off_blank.append(np.abs(depth.numpy() - box_room.depth(pose))[found & (height > 1.5)])
    painted, blank, off_blank = (np.median(np.concatenate(values)) for values in (painted, blank, off_blank))
    assert blank > 5 * painted
    assert 0.4 < blank / off_blank < 2.5  # and about as large as the error is


def test_large_images_are_halved_and_come_back_at_full_size(box_room, walk):
    camera = box_room.camera.resized(562, 422)  # even when halved, 281 x 211, it needs no more
    assert camera.width * camera.height > FULL_SIZE_PIXELS
    large = replace(box_room, camera=camera)
    witness, _ = witness_of(large, walk[:6])
    assert (witness.camera.width, witness.camera.height) == (281, 211)
    depth, beta, pose = next(witness.readings())
    assert depth.shape == beta.shape == (422, 562)
    true, found = large.depth(pose.numpy()), (depth > 0).numpy()
    assert np.median(np.abs(depth.numpy() / true - 1)[found]) < 0.004
    assert all(stored.shape == (211, 281) for stored in witness.depths + witness.betas)


def test_the_view_of_an_odd_size_covers_the_same_field(box_room):
    camera = box_room.camera.resized(641, 481)
    small = PhotometricDepth(camera, PhotometricConfig(), STEPS, VOXEL_M, 0).camera
    edges = [
        ((-0.5 - c.cx) / c.fx, (c.width - 0.5 - c.cx) / c.fx, (c.height - 0.5 - c.cy) / c.fy) for c in (camera, small)
    ]
    np.testing.assert_allclose(*edges)


def test_views_are_chosen_where_the_camera_moved_and_no_more_than_allowed(box_room, walk):
    slow = [pose for pose in walk for _ in range(3)]
    witness, _ = witness_of(box_room, slow)
    assert len(witness.depths) == len(walk)
    assert witness.frames_per_view == 3.0
    few, _ = witness_of(box_room, walk, config=PhotometricConfig(max_views=5))
    assert len(few.depths) == 5
    assert few.frames_per_view == 2.0


def test_same_seed_same_readings_and_state_comes_back(box_room, walk):
    first, loss = witness_of(box_room, walk[:6])
    second, again = witness_of(box_room, walk[:6])
    assert loss == again
    restored = PhotometricDepth(box_room.camera, PhotometricConfig(), STEPS, VOXEL_M, 1)
    restored.load_state_dict(first.state_dict())
    assert restored.frames_per_view == first.frames_per_view
    for other in (second, restored):
        for ours, theirs in zip(first.readings(), other.readings(), strict=True):
            assert all(map(torch.equal, ours, theirs))


@pytest.mark.parametrize(("scale", "exact", "again"), [(1.04, True, True), (1.0, True, False), (1.04, False, False)])
def test_colour_that_is_exact_is_asked_again_where_it_found_another_surface(box_room, walk, scale, exact, again):
    witness, _ = witness_of(box_room, walk, scale=scale)
    witness.confirmed = exact
    assert witness.needs_another_pass() == again
    for _ in range(PhotometricConfig().max_passes - 1):
        assert witness.needs_another_pass() == again
        witness.look(RoomFrames(box_room, walk), dict(enumerate(walk)), OffSurface(box_room, 1.0))
    assert not witness.needs_another_pass()


def test_what_is_kept_of_a_view_lies_on_the_map(box_room, walk):
    """The map is the room, the sensor reads 4 % too far: all three depths of a pixel are known."""
    witness, _ = witness_of(box_room, walk)
    view = 3
    frame = RoomFrames(box_room, walk, scale=1.04)[view]
    features = {"stereo": torch.zeros(*frame.depths["stereo"].shape, 2)}
    witness.sample_view(frame, features, view, RoomSurface(box_room))
    told = witness.samples
    assert set(told["views"].tolist()) == {view}
    expected, points = told["expected"].numpy(), witness.points().numpy()
    np.testing.assert_allclose(witness.origins(), np.broadcast_to(walk[view][:3, 3], points.shape), atol=1e-6)
    assert (expected > 0).all()
    np.testing.assert_allclose(told["sensors"][:, 0] / told["expected"], 1.04, rtol=1e-4)
    assert np.median(np.abs(told["color"].numpy() / expected - 1)) < 0.004
    size = box_room.mesh().vertices.max(0)
    walls = np.minimum(np.abs(points), np.abs(points - size)).min(1)
    np.testing.assert_allclose(walls, 0, atol=1e-4)


def test_views_are_related_if_they_were_compared_with_the_same_image(box_room, walk):
    witness = PhotometricDepth(box_room.camera, PhotometricConfig(), STEPS, VOXEL_M, 0)
    witness.indices, witness.sources = [0, 5, 10, 15], [[5], [20], [20, 30], [40]]
    related = [[1, 1, 0, 0], [1, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_array_equal(witness.related(), np.array(related, dtype=bool))
    looked, _ = witness_of(box_room, walk)
    assert looked.related().shape == (len(walk),) * 2
    assert all(len(sources) >= MIN_SOURCES for sources in looked.sources)


# --- when it says nothing ----------------------------------------------------------------------------------------
def silent(room, walk, **paint) -> bool:
    witness, loss = witness_of(room, walk, **paint)
    return loss is None and not list(witness.readings())


def test_too_few_views(box_room, walk):
    for count in range(4):
        assert silent(box_room, walk[:count])


def test_a_camera_that_stands_or_only_turns(box_room, walk):
    assert silent(box_room, [walk[4]] * 12)
    turns = [box_room.pose(angle) for angle in np.linspace(-0.5, 0.5, 12)]
    for pose in turns:
        pose[:3, 3] = walk[4][:3, 3]
    assert silent(box_room, turns)


def test_pictures_without_anything_on_them(box_room, walk, monkeypatch):
    assert silent(box_room, walk, blank_above_m=-1.0)
    monkeypatch.setattr(type(box_room), "picture", lambda room, pose: np.zeros((120, 160, 3)))
    assert silent(box_room, walk)


def test_an_empty_map(box_room, walk):
    class Nothing(OffSurface):
        def depth_from(self, camera, T_world_camera):
            return np.zeros((camera.height, camera.width), np.float32)

        def median_depth(self, camera, T_world_camera):
            return None

    witness = PhotometricDepth(box_room.camera, PhotometricConfig(), STEPS, VOXEL_M, 0)
    assert witness.look(RoomFrames(box_room, walk), dict(enumerate(walk)), Nothing(box_room, 1.0)) is None


# --- in the map --------------------------------------------------------------------------------------------------
def reconstructed(room, walk, path, *settings, method="uncle", on_event=lambda event: None, interval_s=1e9):
    quick = QUICK if method == "uncle" else QUICK[:2]
    config = make_config(method, [*quick, *settings], sensors=("stereo",), device="cpu")
    frames, checkpoint = RoomFrames(room, walk, scale=1.04), Checkpoint(path, "", interval_s)
    return pipeline.reconstruct(frames, list(range(len(walk))), config, checkpoint, lambda *_: None, on_event)


def off_by(room, mapper: Mapper, walk) -> float:
    """Median distance between map and truth along the views, as a share of depth."""
    surface, misses = mapper.surface(), []
    for pose in walk:
        depth, true = surface.depth_from(room.camera, pose), room.depth(pose)
        misses.append((np.abs(depth / true - 1))[depth > 0])
    return float(np.median(np.concatenate(misses)))


def check_rays_of_the_refinement(room, with_colors: Mapper, without: Mapper) -> None:
    """Sensors without the bias that colour found, as far as they are worth, and colour itself; else sensors as read."""
    sensors, color = with_colors.ray_batches()
    assert sensors.worth.tolist() == pytest.approx([DEFAULT_RELIABILITY])
    assert color.worth.tolist() == [1.0]
    assert abs(beyond_walls(room, sensors)) < 0.012
    assert abs(beyond_walls(room, color)) < 0.006
    (alone,) = without.ray_batches()
    assert alone.worth.tolist() == [1.0]
    assert beyond_walls(room, alone) == pytest.approx(0.04, abs=1e-3)


def beyond_walls(room, rays: RayBatch) -> float:
    """Median share of the depth by which readings of the first source lie beyond the walls along their rays."""
    read = (rays.depths[:, 0] > 0).numpy()
    met = Surface(room.mesh()).cast(rays.origins.numpy()[read], rays.directions.numpy()[read])
    return float(np.median(rays.depths[:, 0].numpy()[read] / met - 1))


def test_the_map_overcomes_a_bias_that_its_only_sensor_always_has(box_room, walk, tmp_path):
    with_colors = reconstructed(box_room, walk, tmp_path / "a")
    without = reconstructed(box_room, walk, tmp_path / "b", "photometric.enabled=false")
    assert len(with_colors.curves["noise/photometric"]) == 3  # asked again: the first surface was off
    assert "pass_4" in with_colors.seconds
    assert "pass_3" not in without.seconds
    assert "noise/photometric" not in without.curves
    assert not without.mapper.witness.depths
    assert off_by(box_room, without.mapper, walk) == pytest.approx(0.04, abs=0.006)
    assert off_by(box_room, with_colors.mapper, walk) < 0.006
    assert with_colors.mapper.bias.confirmed["stereo"] >= CONFIRMED
    assert with_colors.mapper.witness.confirmed
    assert with_colors.mapper.weights.worth == {"stereo": DEFAULT_RELIABILITY}  # all views have an image in common
    assert not without.mapper.bias.confirmed
    assert without.mapper.weights.worth == {"stereo": 1.0}
    check_rays_of_the_refinement(box_room, with_colors.mapper, without.mapper)
    assert not without.mapper.bias.models["stereo"].believed


def test_beta_is_about_readings_with_their_bias(box_room, walk, tmp_path):
    made = reconstructed(box_room, walk, tmp_path / "a")
    frame = RoomFrames(box_room, walk, scale=1.04)[4]
    features = made.mapper.features(frame, {"stereo": torch.from_numpy(box_room.normals(walk[4]))})
    corrected = made.mapper.bias.corrected(frame, features).depths["stereo"].numpy()
    true = box_room.depth(walk[4])
    assert np.median(np.abs(corrected / true - 1)) < 0.012  # as read: 0.04
    beta = made.mapper.noise["stereo"].beta_image(frame.depths["stereo"], features["stereo"]).numpy()
    # All errors are as large as their bias, which just lies in the interval of 50 %: half of them could not.
    assert np.median(beta * np.log(2) / (0.04 * true)) == pytest.approx(1.0, abs=0.15)


def test_colours_that_contradict_what_sensors_see_from_everywhere_are_not_heard(box_room, walk, tmp_path, monkeypatch):
    """Depth is right, the pictures are taken by a camera with another focal length than that of the depth images."""
    wide = replace(box_room, camera=replace(box_room.camera, fx=box_room.camera.fx * 1.1, fy=box_room.camera.fy * 1.1))
    picture = type(box_room).picture
    monkeypatch.setattr(type(box_room), "picture", lambda room, pose: picture(wide, pose))
    frames = RoomFrames(box_room, walk)
    config = make_config("uncle", QUICK, sensors=("stereo",), device="cpu")
    checkpoint = Checkpoint(tmp_path / "a", "", 1e9)
    made = pipeline.reconstruct(frames, list(range(len(walk))), config, checkpoint, lambda *_: None)
    assert made.mapper.bias.confirmed["stereo"] <= REFUTED
    assert not made.mapper.witness.depths
    assert not made.mapper.bias.models["stereo"].believed
    assert off_by(box_room, made.mapper, walk) < 0.004


def test_a_later_look_that_finds_nothing_leaves_what_was_said(box_room, walk, tmp_path, monkeypatch):
    learn, looks = PhotometricDepth._learn, []

    def learn_once(witness, *given):
        looks.append(1)
        return learn(witness, *given) if len(looks) == 1 else None

    monkeypatch.setattr(PhotometricDepth, "_learn", learn_once)
    made = reconstructed(box_room, walk, tmp_path / "a")
    assert len(looks) == 2  # and no third one
    assert len(made.mapper.witness.depths) == len(walk)
    assert made.mapper.bias.models["stereo"].believed
    assert made.mapper.intervals["stereo"]  # learned from the last map
    assert off_by(box_room, made.mapper, walk) < 0.008


@pytest.mark.parametrize(("share", "heard"), [(None, True), (0.0, False)])
def test_a_later_trial_that_confirms_nothing_takes_the_bias_back(
    box_room, walk, tmp_path, monkeypatch, share, heard
):  # fmt: skip
    shares = iter([1.0, share])
    monkeypatch.setattr(CrossViewConsistencyTest, "improved_fraction", lambda *_: next(shares))
    made = reconstructed(box_room, walk, tmp_path / "a")
    assert next(shares, "asked twice") == "asked twice"
    assert not made.mapper.bias.models["stereo"].believed
    assert made.mapper.bias.confirmed == ({} if share is None else {"stereo": share})
    assert not made.mapper.witness.confirmed
    assert made.mapper.weights.worth == {"stereo": 1.0}
    assert bool(made.mapper.witness.depths) == heard


def test_colour_is_asked_as_often_as_is_set(box_room, walk, tmp_path):
    once = reconstructed(box_room, walk, tmp_path / "a", "photometric.max_passes=1")
    assert len(once.curves["noise/photometric"]) == 1
    assert {"pass_2"} == {part for part in once.seconds if part in ("pass_2", "pass_3", "pass_4")}
    more = reconstructed(box_room, walk, tmp_path / "b", "photometric.max_passes=2", "fusion.passes=3")
    assert len(more.curves["noise/photometric"]) == 2
    assert "pass_4" in more.seconds


def test_a_bias_below_that_of_colour_is_left_alone(box_room, walk, tmp_path, monkeypatch):
    monkeypatch.setattr(BiasModel, "exceeds_photometric_bias", lambda *_: False)
    made = reconstructed(box_room, walk, tmp_path / "a")
    assert made.mapper.bias.confirmed["stereo"] >= CONFIRMED
    assert not made.mapper.bias.models["stereo"].believed
    assert made.mapper.witness.confirmed


def test_readings_are_worth_what_predicts_colour_of_unrelated_views(box_room, walk, tmp_path, monkeypatch):
    monkeypatch.setattr(PhotometricDepth, "related", lambda witness: np.eye(len(witness.indices), dtype=bool))
    made = reconstructed(box_room, walk, tmp_path / "a")
    assert made.mapper.weights.worth["stereo"] not in (1.0, DEFAULT_RELIABILITY)
    assert off_by(box_room, made.mapper, walk) < 0.008


def test_readings_are_worth_alike_if_so_set(box_room, walk, tmp_path):
    made = reconstructed(box_room, walk, tmp_path / "a", "photometric.estimate_reliability=false")
    assert made.mapper.witness.confirmed
    assert made.mapper.weights.worth == {"stereo": DEFAULT_RELIABILITY}


OFF = ["uncertainty.enabled=false", "photometric.enabled=false", "fusion.passes=0"]


@pytest.mark.parametrize(("method", "settings"), [("tsdf", []), *(("uncle", [setting]) for setting in OFF)])
def test_colours_are_not_looked_at(box_room, walk, tmp_path, monkeypatch, method, settings):
    def refuse(*_):
        raise AssertionError("looked at colours")

    monkeypatch.setattr(PhotometricDepth, "look", refuse)
    made = reconstructed(box_room, walk[:4], tmp_path / "c", *settings, method=method)
    assert not list(made.mapper.witness.readings())


@pytest.mark.parametrize("stage", ["fusing again, sweep 2", "fusing again, sweep 3"])
def test_a_map_that_was_broken_off_is_the_same_with_colours(box_room, walk, tmp_path, stage):
    def break_off(event) -> None:
        if isinstance(event, Progress) and event.stage == stage and event.done == 4:
            raise InterruptedError

    unbroken = reconstructed(box_room, walk, tmp_path / "a")
    with pytest.raises(InterruptedError):
        reconstructed(box_room, walk, tmp_path / "b", on_event=break_off, interval_s=0)
    said: list[str] = []
    resumed = reconstructed(box_room, walk, tmp_path / "b", on_event=lambda event: said.append(str(event)))
    assert any(f"continuing at {stage.split(', ')[1]}" in text for text in said)
    assert len(resumed.mapper.witness.depths) == len(walk)
    for ours, theirs in zip(unbroken.mapper.witness.readings(), resumed.mapper.witness.readings(), strict=True):
        assert all(map(torch.equal, ours, theirs))
    assert torch.equal(unbroken.mapper.volume.sums, resumed.mapper.volume.sums)
    assert torch.equal(unbroken.mapper.volume.grid.blocks, resumed.mapper.volume.grid.blocks)
    assert unbroken.curves == resumed.curves


def test_a_view_weighs_as_much_as_the_frames_it_stands_for(box_room, walk):
    """Fused alone: each sample holds frames_per_view times the weight of beta, and the surface lies at the
    readings."""
    config = make_config("uncle", ["fusion.voxel_size_m=0.05", "fusion.discretisation_voxels=1"], device="cpu")
    mapper = Mapper(box_room.camera, ("stereo",), config, torch.device("cpu"))
    depth = torch.full((120, 160), 2.0)
    witness = mapper.witness
    witness.frames, witness.indices, witness.poses = 7, [0], [torch.eye(4)]
    witness.depths, witness.betas = [depth], [torch.full_like(depth, 0.0625).half()]
    mapper.add_colors()
    mapper.add_colors()
    volume = mapper.volume
    positions = volume.grid.block_positions(torch.arange(len(volume.grid.blocks))).view(-1, 3)
    near = ((positions[:, 2] - 2.0).abs() < 0.1) & (volume.counts() == 2)
    assert near.sum() > 1000
    expected = 2 * 7 * mapper.weights.of(torch.tensor(0.0625))
    torch.testing.assert_close(volume.sums[near, 0], expected.expand(int(near.sum())), rtol=1e-4, atol=0)
    torch.testing.assert_close(volume.sdf()[near], 2.0 - positions[near, 2], atol=1e-4, rtol=0)
    assert not volume.color_sums.any()
    assert mapper.weight_share() == {"stereo": 0.0}
