"""Photometric depth: what it corrects, its error scale, its schedule, and when there is none."""

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
from uncle.recon.methods.uncle.pipeline import Reconstruction, ray_batches
from uncle.recon.methods.uncle.ray_batch import RayBatch
from uncle.recon.methods.uncle.views import noise_inputs
from uncle.recon.mvs import photometric_depth
from uncle.recon.mvs.bias_model import BiasModel
from uncle.recon.mvs.bias_validation import ConsistencyTestParameters, CrossViewConsistencyTest, Validation
from uncle.recon.mvs.photometric_depth import PhotometricDepth, PhotometricView
from uncle.recon.mvs.photometric_samples import PhotometricDepthImage
from uncle.recon.mvs.sensor_reliability import DEFAULT_RELIABILITY
from uncle.recon.mvs.stereo_views import StereoParameters
from uncle.recon.mvs.view_selection import ViewSelectionParameters
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.frames import RunFrames

STEPS = UncertaintyConfig(steps_per_pass=150, learning_rate=0.01)
VOXEL_M = 0.05
QUICK = [
    "fusion.voxel_size_m=0.05", "fusion.min_observations=2", "keyframes.rays=500", "field.iterations=0",
    "uncertainty.steps_per_keyframe=4", "uncertainty.steps_per_pass=120", "uncertainty.learning_rate=0.01",
]  # fmt: skip


class RoomFrames(RunFrames):
    """The painted room in memory; its one sensor measures `scale` times the true depth. `paint`: of the images."""

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

    def depth_along_rays(self, rays, T_world_camera):
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


def first_pass(room, walk, scale=1.04, config=None, **paint) -> tuple[PhotometricDepth, float | None]:
    frames = RoomFrames(room, walk, **paint)
    photometric = PhotometricDepth(room.camera, config or PhotometricConfig(), STEPS, VOXEL_M, seed=0)
    return photometric, photometric.update(frames, dict(enumerate(walk)), OffSurface(room, scale))


def heights(room, pose) -> np.ndarray:
    """(H, W) of what is seen above the floor, metres."""
    return (room.camera.rays().numpy() @ pose[:3, :3].T)[..., 2] * room.depth(pose) + pose[2, 3]


# --- results -----------------------------------------------------------------------------------------------------
def test_depth_is_nearer_to_the_truth_than_the_map(box_room, walk):
    photometric, loss = first_pass(box_room, walk)
    images = list(photometric.depth_images())
    assert len(images) == len(walk)
    assert np.isfinite(loss)
    assert photometric.frames_per_view == 1.0
    for image, true_pose in zip(images, walk, strict=True):
        depth, beta, pose = image.depth, image.beta, image.T_world_camera
        assert depth.shape == beta.shape == (box_room.camera.height, box_room.camera.width)
        np.testing.assert_allclose(pose.numpy(), true_pose, atol=1e-6)
        true, found = box_room.depth(true_pose), (depth > 0).numpy()
        assert found.mean() > 0.7
        assert np.median(np.abs(depth.numpy() / true - 1)[found]) < 0.004  # the map: 0.04
        assert ((beta > 0).numpy() == found).all()


def test_beta_is_large_where_nothing_is_painted(box_room, walk):
    photometric, _ = first_pass(box_room, walk, grain=1.0, blank_above_m=1.25)
    painted, blank, off_blank = [], [], []
    for image, pose in zip(photometric.depth_images(), walk, strict=True):
        depth, beta = image.depth, image.beta
        height, found = heights(box_room, pose), depth.numpy() > 0
        painted.append(beta.numpy()[found & (height < 1.0)])
        blank.append(beta.numpy()[found & (height > 1.5)])
        off_blank.append(np.abs(depth.numpy() - box_room.depth(pose))[found & (height > 1.5)])
    painted, blank, off_blank = (np.median(np.concatenate(values)) for values in (painted, blank, off_blank))
    assert blank > 5 * painted
    assert 0.4 < blank / off_blank < 2.5  # and about as large as the error is


def test_large_images_are_halved_and_come_back_at_full_size(box_room, walk):
    camera = box_room.camera.resized(562, 422)  # even when halved, 281 x 211, it needs no more
    assert camera.width * camera.height > StereoParameters.max_pixels
    large = replace(box_room, camera=camera)
    photometric, _ = first_pass(large, walk[:6])
    assert (photometric.camera.width, photometric.camera.height) == (281, 211)
    image = next(photometric.depth_images())
    depth, beta, pose = image.depth, image.beta, image.T_world_camera
    assert depth.shape == beta.shape == (422, 562)
    true, found = large.depth(pose.numpy()), (depth > 0).numpy()
    assert np.median(np.abs(depth.numpy() / true - 1)[found]) < 0.004
    assert all(view.depth.shape == view.beta.shape == (211, 281) for view in photometric.views)


def test_the_view_of_an_odd_size_covers_the_same_field(box_room):
    camera = box_room.camera.resized(641, 481)
    small = PhotometricDepth(camera, PhotometricConfig(), STEPS, VOXEL_M, 0).camera
    edges = [
        ((-0.5 - c.cx) / c.fx, (c.width - 0.5 - c.cx) / c.fx, (c.height - 0.5 - c.cy) / c.fy) for c in (camera, small)
    ]
    np.testing.assert_allclose(*edges)


def test_views_are_chosen_where_the_camera_moved_and_no_more_than_allowed(box_room, walk):
    slow = [pose for pose in walk for _ in range(3)]
    photometric, _ = first_pass(box_room, slow)
    assert len(photometric.views) == len(walk)
    assert photometric.frames_per_view == 3.0
    few, _ = first_pass(box_room, walk, config=PhotometricConfig(max_views=5))
    assert len(few.views) == 5
    assert few.frames_per_view == 2.0


def test_same_seed_same_depth_and_state_is_restored(box_room, walk):
    first, loss = first_pass(box_room, walk[:6])
    second, again = first_pass(box_room, walk[:6])
    assert loss == again
    restored = PhotometricDepth(box_room.camera, PhotometricConfig(), STEPS, VOXEL_M, 1)
    restored.load_state_dict(first.state_dict())
    assert restored.frames_per_view == first.frames_per_view
    for other in (second, restored):
        for ours, theirs in zip(first.depth_images(), other.depth_images(), strict=True):
            assert all(map(torch.equal, vars(ours).values(), vars(theirs).values()))


@pytest.mark.parametrize(("scale", "exact", "again"), [(1.04, True, True), (1.0, True, False), (1.04, False, False)])
def test_another_pass_is_needed_if_validated_depth_is_off_the_map(box_room, walk, scale, exact, again):
    photometric, _ = first_pass(box_room, walk, scale=scale)
    photometric.set_validation(Validation.ACCEPTED if exact else Validation.UNDECIDED)
    assert photometric.needs_another_pass() == again
    for _ in range(PhotometricConfig().max_passes - 1):
        assert photometric.needs_another_pass() == again
        photometric.update(RoomFrames(box_room, walk), dict(enumerate(walk)), OffSurface(box_room, 1.0))
    assert not photometric.needs_another_pass()


def test_samples_of_a_view_lie_on_the_map(box_room, walk):
    """The map is the room, the sensor measures 4 % too far: all three depths of a pixel are known."""
    photometric, _ = first_pass(box_room, walk)
    frames = RoomFrames(box_room, walk, scale=1.04)
    views = ((frames[i], {"stereo": torch.zeros(*frames[i].depths["stereo"].shape, 2)}) for i in photometric.indices)
    photometric.collect_samples(views, RoomSurface(box_room))
    samples = photometric.samples
    assert samples.view.unique().tolist() == list(range(len(walk)))
    map_depth, points = samples.map_depth.numpy(), samples.points().numpy()
    np.testing.assert_allclose(samples.origins, np.array(walk)[samples.view, :3, 3], atol=1e-6)
    assert (map_depth > 0).all()
    depth, _ = samples.measured_by("stereo")
    np.testing.assert_allclose(depth / samples.map_depth, 1.04, rtol=1e-4)
    residuals = samples.sensor_residuals("stereo")
    torch.testing.assert_close(residuals.metres, depth - samples.depth)
    torch.testing.assert_close(residuals.reference_scale, samples.beta)
    assert np.median(np.abs(samples.depth.numpy() / map_depth - 1)) < 0.004
    size = box_room.mesh().vertices.max(0)
    walls = np.minimum(np.abs(points), np.abs(points - size)).min(1)
    np.testing.assert_allclose(walls, 0, atol=1e-4)


def test_views_share_images_if_they_were_matched_with_the_same_one(box_room, walk):
    photometric = PhotometricDepth(box_room.camera, PhotometricConfig(), STEPS, VOXEL_M, 0)
    empty, sources = torch.zeros(1, 1), {0: (5,), 5: (20,), 10: (20, 30), 15: (40,)}
    photometric.views = [
        PhotometricView(index, others, torch.eye(4), empty, empty) for index, others in sources.items()
    ]
    shared = [[1, 1, 0, 0], [1, 1, 1, 0], [0, 1, 1, 0], [0, 0, 0, 1]]
    np.testing.assert_array_equal(photometric.share_source_images(), np.array(shared, dtype=bool))
    matched, _ = first_pass(box_room, walk)
    assert matched.share_source_images().shape == (len(walk),) * 2
    assert all(len(view.sources) >= ViewSelectionParameters.min_sources for view in matched.views)


# --- when there is none -------------------------------------------------------------------------------------------
def has_none(room, walk, **paint) -> bool:
    photometric, loss = first_pass(room, walk, **paint)
    return loss is None and not list(photometric.depth_images())


def test_too_few_views(box_room, walk):
    for count in range(4):
        assert has_none(box_room, walk[:count])


def test_a_camera_that_stands_or_only_rotates(box_room, walk):
    assert has_none(box_room, [walk[4]] * 12)
    turns = [box_room.pose(angle) for angle in np.linspace(-0.5, 0.5, 12)]
    for pose in turns:
        pose[:3, 3] = walk[4][:3, 3]
    assert has_none(box_room, turns)


def test_pictures_without_anything_on_them(box_room, walk, monkeypatch):
    assert has_none(box_room, walk, blank_above_m=-1.0)
    monkeypatch.setattr(type(box_room), "picture", lambda room, pose: np.zeros((120, 160, 3)))
    assert has_none(box_room, walk)


def test_an_empty_map(box_room, walk):
    class Nothing(OffSurface):
        def depth_from(self, camera, T_world_camera):
            return np.zeros((camera.height, camera.width), np.float32)

        def median_depth(self, camera, T_world_camera):
            return None

    photometric = PhotometricDepth(box_room.camera, PhotometricConfig(), STEPS, VOXEL_M, 0)
    assert photometric.update(RoomFrames(box_room, walk), dict(enumerate(walk)), Nothing(box_room, 1.0)) is None


# --- in the map --------------------------------------------------------------------------------------------------
def reconstructed(room, walk, path, *settings, method="uncle", on_event=lambda event: None, interval_s=1e9):
    quick = QUICK if method == "uncle" else QUICK[:2]
    config = make_config(method, [*quick, *settings], sensors=("stereo",), device="cpu")
    frames, checkpoint = RoomFrames(room, walk, scale=1.04), Checkpoint(path, "", interval_s)
    return pipeline.reconstruct(frames, list(range(len(walk))), config, checkpoint, lambda *_: None, on_event)


def map_error(room, made: Reconstruction, walk) -> float:
    """Median distance between map and truth along the views, as a share of depth."""
    surface, errors = made.state.mapper.surface(), []
    for pose in walk:
        depth, true = surface.depth_from(room.camera, pose), room.depth(pose)
        errors.append((np.abs(depth / true - 1))[depth > 0])
    return float(np.median(np.concatenate(errors)))


def check_rays_of_the_refinement(room, with_colors: Reconstruction, without: Reconstruction) -> None:
    """Bias-corrected sensors with their reliability, and photometric depth; without it sensors as measured."""
    sensors, color = ray_batches(with_colors.state)
    assert sensors.reliability.tolist() == pytest.approx([DEFAULT_RELIABILITY])
    assert color.reliability.tolist() == [1.0]
    assert abs(beyond_walls(room, sensors)) < 0.012
    assert abs(beyond_walls(room, color)) < 0.006
    (alone,) = ray_batches(without.state)
    assert alone.reliability.tolist() == [1.0]
    assert beyond_walls(room, alone) == pytest.approx(0.04, abs=1e-3)


def beyond_walls(room, rays: RayBatch) -> float:
    """Median share of the depth by which measurements of the first source lie beyond the walls along their rays."""
    read = (rays.depths[:, 0] > 0).numpy()
    met = Surface(room.mesh()).cast(rays.origins.numpy()[read], rays.directions.numpy()[read])
    return float(np.median(rays.depths[:, 0].numpy()[read] / met - 1))


def test_the_map_overcomes_a_bias_that_its_only_sensor_always_has(box_room, walk, tmp_path):
    with_colors = reconstructed(box_room, walk, tmp_path / "a")
    without = reconstructed(box_room, walk, tmp_path / "b", "photometric.enabled=false")
    assert len(with_colors.curves["noise/photometric"]) == 3  # needs more passes: the first surface was off
    assert "pass_4" in with_colors.seconds
    assert "pass_3" not in without.seconds
    assert "noise/photometric" not in without.curves
    assert not without.state.photometric.views
    assert map_error(box_room, without, walk) == pytest.approx(0.04, abs=0.006)
    assert map_error(box_room, with_colors, walk) < 0.006
    assert with_colors.state.biases.improved_fraction["stereo"] >= ConsistencyTestParameters.accepted_fraction
    assert with_colors.state.photometric.validated
    assert with_colors.state.mapper.weights.reliability == {
        "stereo": DEFAULT_RELIABILITY
    }  # all views have an image in common
    assert not without.state.biases.improved_fraction
    assert without.state.mapper.weights.reliability == {"stereo": 1.0}
    check_rays_of_the_refinement(box_room, with_colors, without)
    assert not without.state.biases.models["stereo"].active


def test_beta_describes_measurements_with_their_bias(box_room, walk, tmp_path):
    made = reconstructed(box_room, walk, tmp_path / "a")
    frame = RoomFrames(box_room, walk, scale=1.04)[4]
    inputs = noise_inputs(frame, {"stereo": torch.from_numpy(box_room.normals(walk[4]))}, box_room.camera)
    corrected = made.state.biases.correct(frame, inputs).depths["stereo"].numpy()
    true = box_room.depth(walk[4])
    assert np.median(np.abs(corrected / true - 1)) < 0.012  # as measured: 0.04
    beta = made.state.noise.models["stereo"].beta_image(frame.depths["stereo"], inputs["stereo"]).numpy()
    # All errors are as large as their bias, which just lies in the interval of 50 %: half of them could not.
    assert np.median(beta * np.log(2) / (0.04 * true)) == pytest.approx(1.0, abs=0.15)


def test_photometric_depth_is_rejected_if_the_views_of_a_sensor_contradict_it(box_room, walk, tmp_path, monkeypatch):
    """Depth is right, the pictures are taken by a camera with another focal length than that of the depth images."""
    wide = replace(box_room, camera=replace(box_room.camera, fx=box_room.camera.fx * 1.1, fy=box_room.camera.fy * 1.1))
    picture = type(box_room).picture
    monkeypatch.setattr(type(box_room), "picture", lambda room, pose: picture(wide, pose))
    frames = RoomFrames(box_room, walk)
    config = make_config("uncle", QUICK, sensors=("stereo",), device="cpu")
    checkpoint = Checkpoint(tmp_path / "a", "", 1e9)
    made = pipeline.reconstruct(frames, list(range(len(walk))), config, checkpoint, lambda *_: None)
    assert made.state.biases.improved_fraction["stereo"] <= ConsistencyTestParameters.rejected_fraction
    assert not made.state.photometric.views
    assert not made.state.biases.models["stereo"].active
    assert map_error(box_room, made, walk) < 0.004


def test_a_later_pass_without_result_leaves_that_of_the_earlier_one(box_room, walk, tmp_path, monkeypatch):
    fit, calls = photometric_depth.fit_photometric_noise, []

    def fit_once(*given):
        calls.append(1)
        return fit(*given) if len(calls) == 1 else None

    monkeypatch.setattr(photometric_depth, "fit_photometric_noise", fit_once)
    made = reconstructed(box_room, walk, tmp_path / "a")
    assert len(calls) == 2  # and no third one
    assert len(made.state.photometric.views) == len(walk)
    assert made.state.biases.models["stereo"].active
    assert made.state.noise.error_quantiles["stereo"]  # learned from the last map
    assert map_error(box_room, made, walk) < 0.008


@pytest.mark.parametrize(("share", "kept"), [(None, True), (0.0, False)])
def test_a_later_fit_that_is_not_accepted_deactivates_the_bias(
    box_room, walk, tmp_path, monkeypatch, share, kept
):  # fmt: skip
    shares = iter([1.0, share])
    monkeypatch.setattr(CrossViewConsistencyTest, "improved_fraction", lambda *_: next(shares))
    made = reconstructed(box_room, walk, tmp_path / "a")
    assert next(shares, "no third fit") == "no third fit"
    assert not made.state.biases.models["stereo"].active
    assert made.state.biases.improved_fraction == ({} if share is None else {"stereo": share})
    assert not made.state.photometric.validated
    assert made.state.mapper.weights.reliability == {"stereo": 1.0}
    assert bool(made.state.photometric.views) == kept


def test_the_number_of_passes_is_limited_by_the_setting(box_room, walk, tmp_path):
    once = reconstructed(box_room, walk, tmp_path / "a", "photometric.max_passes=1")
    assert len(once.curves["noise/photometric"]) == 1
    assert {"pass_2"} == {part for part in once.seconds if part in ("pass_2", "pass_3", "pass_4")}
    more = reconstructed(box_room, walk, tmp_path / "b", "photometric.max_passes=2", "fusion.passes=3")
    assert len(more.curves["noise/photometric"]) == 2
    assert "pass_4" in more.seconds


def test_a_bias_below_that_of_photometric_depth_is_not_corrected(box_room, walk, tmp_path, monkeypatch):
    monkeypatch.setattr(BiasModel, "exceeds_photometric_bias", lambda *_: False)
    made = reconstructed(box_room, walk, tmp_path / "a")
    assert made.state.biases.improved_fraction["stereo"] >= ConsistencyTestParameters.accepted_fraction
    assert not made.state.biases.models["stereo"].active
    assert made.state.photometric.validated


def test_reliability_is_estimated_from_independent_views(box_room, walk, tmp_path, monkeypatch):
    monkeypatch.setattr(PhotometricDepth, "share_source_images", lambda self: np.eye(len(self.views), dtype=bool))
    made = reconstructed(box_room, walk, tmp_path / "a")
    assert made.state.mapper.weights.reliability["stereo"] not in (1.0, DEFAULT_RELIABILITY)
    assert map_error(box_room, made, walk) < 0.008


def test_reliability_is_the_default_if_it_is_not_to_be_estimated(box_room, walk, tmp_path):
    made = reconstructed(box_room, walk, tmp_path / "a", "photometric.estimate_reliability=false")
    assert made.state.photometric.validated
    assert made.state.mapper.weights.reliability == {"stereo": DEFAULT_RELIABILITY}


OFF = ["uncertainty.enabled=false", "photometric.enabled=false", "fusion.passes=0"]


@pytest.mark.parametrize(("method", "settings"), [("tsdf", []), *(("uncle", [setting]) for setting in OFF)])
def test_there_is_no_photometric_pass(box_room, walk, tmp_path, monkeypatch, method, settings):
    def fail(*_):
        raise AssertionError("a photometric pass")

    monkeypatch.setattr(PhotometricDepth, "update", fail)
    made = reconstructed(box_room, walk[:4], tmp_path / "c", *settings, method=method)
    assert not list(made.state.photometric.depth_images())


@pytest.mark.parametrize("stage", ["integrating, pass 2", "integrating, pass 3"])
def test_a_map_that_was_interrupted_is_the_same(box_room, walk, tmp_path, stage):
    def interrupt(event) -> None:
        if isinstance(event, Progress) and event.stage == stage and event.done == 4:
            raise InterruptedError

    unbroken = reconstructed(box_room, walk, tmp_path / "a")
    with pytest.raises(InterruptedError):
        reconstructed(box_room, walk, tmp_path / "b", on_event=interrupt, interval_s=0)
    texts: list[str] = []
    resumed = reconstructed(box_room, walk, tmp_path / "b", on_event=lambda event: texts.append(str(event)))
    assert any(f"continuing at {stage.split(', ')[1]}" in text for text in texts)
    assert len(resumed.state.photometric.views) == len(walk)
    both = (unbroken.state.photometric.depth_images(), resumed.state.photometric.depth_images())
    for ours, theirs in zip(*both, strict=True):
        assert all(map(torch.equal, vars(ours).values(), vars(theirs).values()))
    assert torch.equal(unbroken.state.mapper.volume.sums, resumed.state.mapper.volume.sums)
    assert torch.equal(unbroken.state.mapper.volume.grid.blocks, resumed.state.mapper.volume.grid.blocks)
    assert unbroken.curves == resumed.curves


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


@pytest.mark.parametrize(("error_px", "is_used"), [(0.0, True), (1.0, True), (3.0, False)])
def test_photometric_depth_is_skipped_if_the_registration_is_off(
    box_room, walk, tmp_path, monkeypatch, error_px, is_used
):  # fmt: skip
    calls, events = [], []
    monkeypatch.setattr(PhotometricDepth, "update", lambda *_: calls.append(1))
    monkeypatch.setattr(RoomFrames, "registration_sigma_px", error_px)
    reconstructed(box_room, walk[:2], tmp_path / "a", on_event=events.append)
    assert bool(calls) == is_used
    assert any("off by 3 px" in getattr(event, "text", "") for event in events) != is_used
