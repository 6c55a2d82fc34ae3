"""Photometric depth: what it corrects, its error scale, its schedule, and when there is none."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from uncle.recon.core.config.uncle import PhotometricConfig, UncertaintyConfig
from uncle.recon.mvs.bias_validation import Validation
from uncle.recon.mvs.photometric_depth import PhotometricDepth, PhotometricView
from uncle.recon.mvs.stereo_views import StereoParameters
from uncle.recon.mvs.view_selection import ViewSelectionParameters

STEPS = UncertaintyConfig(steps_per_pass=150, learning_rate=0.01)
VOXEL_M = 0.05


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


@pytest.fixture
def first_pass(painted_frames):
    """One photometric pass of a room, whose map is too deep by `scale`; also returns its loss."""

    def run(room, walk, scale=1.04, config=None, **paint) -> tuple[PhotometricDepth, float | None]:
        frames = painted_frames(room, walk, **paint)
        photometric = PhotometricDepth(room.camera, config or PhotometricConfig(), STEPS, VOXEL_M, seed=0)
        return photometric, photometric.update(frames, dict(enumerate(walk)), OffSurface(room, scale))

    return run


def heights(room, pose) -> np.ndarray:
    """(H, W) of what is seen above the floor, metres."""
    return (room.camera.rays().numpy() @ pose[:3, :3].T)[..., 2] * room.depth(pose) + pose[2, 3]


# --- results -----------------------------------------------------------------------------------------------------
def test_depth_is_nearer_to_the_truth_than_the_map(box_room, walk, first_pass):
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


def test_beta_is_large_where_nothing_is_painted(box_room, walk, first_pass):
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


def test_large_images_are_halved_and_come_back_at_full_size(box_room, walk, first_pass):
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


def test_views_are_chosen_where_the_camera_moved_and_no_more_than_allowed(box_room, walk, first_pass):
    slow = [pose for pose in walk for _ in range(3)]
    photometric, _ = first_pass(box_room, slow)
    assert len(photometric.views) == len(walk)
    assert photometric.frames_per_view == 3.0
    few, _ = first_pass(box_room, walk, config=PhotometricConfig(max_views=5))
    assert len(few.views) == 5
    assert few.frames_per_view == 2.0


def test_same_seed_same_depth_and_state_is_restored(box_room, walk, first_pass):
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
def test_another_pass_is_needed_if_validated_depth_is_off_the_map(
    box_room, walk, first_pass, painted_frames, scale, exact, again
):
    photometric, _ = first_pass(box_room, walk, scale=scale)
    photometric.set_validation(Validation.ACCEPTED if exact else Validation.UNDECIDED)
    assert photometric.needs_another_pass() == again
    for _ in range(PhotometricConfig().max_passes - 1):
        assert photometric.needs_another_pass() == again
        photometric.update(painted_frames(box_room, walk), dict(enumerate(walk)), OffSurface(box_room, 1.0))
    assert not photometric.needs_another_pass()


def test_samples_of_a_view_lie_on_the_map(box_room, walk, first_pass, painted_frames):
    """The map is the room, the sensor measures 4 % too far: all three depths of a pixel are known."""
    photometric, _ = first_pass(box_room, walk)
    frames = painted_frames(box_room, walk, scale=1.04)
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


def test_views_share_images_if_they_were_matched_with_the_same_one(box_room, walk, first_pass):
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
@pytest.fixture
def has_none(first_pass):
    def run(room, walk, **paint) -> bool:
        photometric, loss = first_pass(room, walk, **paint)
        return loss is None and not list(photometric.depth_images())

    return run


def test_too_few_views(box_room, walk, has_none):
    for count in range(4):
        assert has_none(box_room, walk[:count])


def test_a_camera_that_stands_or_only_rotates(box_room, walk, has_none):
    assert has_none(box_room, [walk[4]] * 12)
    turns = [box_room.pose(angle) for angle in np.linspace(-0.5, 0.5, 12)]
    for pose in turns:
        pose[:3, 3] = walk[4][:3, 3]
    assert has_none(box_room, turns)


def test_pictures_without_anything_on_them(box_room, walk, monkeypatch, has_none):
    assert has_none(box_room, walk, blank_above_m=-1.0)
    monkeypatch.setattr(type(box_room), "picture", lambda room, pose: np.zeros((120, 160, 3)))
    assert has_none(box_room, walk)


def test_an_empty_map(box_room, walk, painted_frames):
    class Nothing(OffSurface):
        def depth_from(self, camera, T_world_camera):
            return np.zeros((camera.height, camera.width), np.float32)

        def median_depth(self, camera, T_world_camera):
            return None

    photometric = PhotometricDepth(box_room.camera, PhotometricConfig(), STEPS, VOXEL_M, 0)
    assert photometric.update(painted_frames(box_room, walk), dict(enumerate(walk)), Nothing(box_room, 1.0)) is None
