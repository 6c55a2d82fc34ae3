"""Training of SenFuNet: the true distance, the loss, the data file, and that it learns."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from uncle.recon.core.errors import ConfigError, DataError
from uncle.recon.methods.pretrain.senfunet import SenfunetTraining, is_outlier, measure, senfunet_loss, train_senfunet
from uncle.recon.methods.pretrain.senfunet_scenes import Scene, collect_scene, load_scenes, save_scenes
from uncle.recon.methods.senfunet.models import SenfunetModel


class BoxSource:
    """A recording of the box room: sensor `good` is right, sensor `far` reads 20 cm too far."""

    sensors = ("gt", "good", "far")
    has_poses = True

    def __init__(self, room, mesh_path, frames: int = 4) -> None:
        self.room, self.camera, self.reference_mesh = room, room.camera, mesh_path
        self.poses = [room.pose(angle) for angle in np.linspace(0, 2 * np.pi, frames, endpoint=False)]

    def __len__(self) -> int:
        return len(self.poses)

    def pose(self, index: int) -> np.ndarray:
        return self.poses[index]

    def color(self, index: int) -> torch.Tensor:
        return torch.from_numpy(self.room.picture(self.poses[index]))

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        true = torch.from_numpy(self.room.depth(self.poses[index])).float()
        return true + 0.2 if sensor == "far" else true


@pytest.fixture(scope="module")
def source(box_room, tmp_path_factory) -> BoxSource:
    path = tmp_path_factory.mktemp("room") / "mesh.ply"
    box_room.mesh().save(path)
    return BoxSource(box_room, path)


@pytest.fixture(scope="module")
def scene(source) -> Scene:
    return collect_scene("box", source, ("good", "far"), 4, 0.08, 5)


def test_the_true_distance_is_that_to_the_nearest_wall_where_a_camera_looked(scene, box_room):
    truth = scene.truth
    inside = np.array([[0.15, 1.5, 1.2], [3.8, 1.5, 1.2], [2.0, 0.2, 1.2], [2.0, 2.9, 1.2]])
    behind = np.array([[-0.15, 1.5, 1.2], [4.2, 1.5, 1.2], [2.0, -0.3, 1.2], [2.0, 3.1, 1.2]])
    for points in (inside, behind):
        index = np.rint(points / 0.08).astype(int)
        exact = [_distance(row * 0.08, box_room) for row in index]
        found = truth.steps[tuple((index - truth.first).T)] / 127 * truth.truncation_m
        np.testing.assert_allclose(found, np.clip(exact, -0.4, 0.4), atol=0.004)
    middle = np.rint(np.array([2.0, 1.5, 1.2]) / 0.08).astype(int) - truth.first
    assert truth.steps[tuple(middle)] == 127


def _distance(point: np.ndarray, room) -> float:
    """Metres to the nearest wall, negative outside."""
    size = np.array([4.0, 3.0, 2.5])
    gaps = np.minimum(point, size - point)
    return float(gaps.min()) if (gaps > 0).all() else -float(np.linalg.norm(np.minimum(gaps, 0)))


def test_the_loss_is_the_formula():
    t = 0.1
    alpha = torch.tensor([0.25, 0.7, 0.7, 0.4])
    first, second = torch.tensor([0.02, 0.09, 0.01, 0.0]), torch.tensor([0.06, 0.0, 0.0, -0.05])
    truth = torch.tensor([0.03, -0.09, 0.02, -0.06])
    w1, w2 = torch.tensor([2.0, 1.0, 1.0, 0.0]), torch.tensor([1.0, 0.0, 0.0, 3.0])
    both = 6 * abs(0.25 * 0.02 + 0.75 * 0.06 - 0.03) * 0.5  # scaled to a truncation of 5 cm
    first_alone = (10 * 0.7 + (1 - 0.7)) / 2  # the second sample is an outlier, the third is not
    second_alone = 1 - (1 - 0.4)
    expected = both + 0.01 * (first_alone + second_alone)
    assert float(senfunet_loss(alpha, first, second, w1, w2, truth, t)) == pytest.approx(expected, rel=1e-5)


def test_an_outlier_is_far_off_and_on_the_wrong_side():
    sdf, truth = torch.tensor([0.05, 0.05, -0.1, 0.1]), torch.tensor([-0.04, 0.0, -0.01, 0.01])
    assert is_outlier(sdf, truth, 0.1).tolist() == [True, False, False, False]


def test_it_learns_which_sensor_is_right(scene):
    settings = SenfunetTraining(frames=20, accumulate=1, bricks=4, learning_rate=5e-3)
    trained = train_senfunet([scene], ("good", "far"), settings)
    errors = trained.errors
    assert errors["error_good_m"] < errors["error_mean_m"] < errors["error_far_m"]
    untrained = SenfunetModel.fresh(("good", "far"), 0.08, torch.Generator().manual_seed(0))
    assert errors["error_learned_m"] < 0.75 * measure(scene, untrained)["error_learned_m"]
    assert np.mean(trained.losses[-6:]) < np.mean(trained.losses[:6])
    assert trained.recipe([scene], settings)["frames_seen"] == 20


def test_the_data_file_gives_the_scenes_back(scene, tmp_path):
    save_scenes(tmp_path / "scenes.npz", [scene])
    (loaded,) = load_scenes(tmp_path / "scenes.npz")
    assert loaded.camera == scene.camera
    assert len(loaded) == 4
    np.testing.assert_array_equal(loaded.truth.steps, scene.truth.steps)
    assert torch.equal(loaded.depth(2, "far"), scene.depth(2, "far"))
    assert torch.equal(loaded.color(3), scene.color(3))


def test_the_image_kept_is_the_image_seen(scene, source):
    error = (scene.color(0).float() - source.color(0).float()).abs().mean()
    assert float(error) < 4  # levels of 255; JPEG
    assert float((scene.depth(1, "far") - source.depth(1, "far")).abs().max()) < 6e-4


def test_broken_data_is_named(tmp_path):
    path = tmp_path / "scenes.npz"
    path.write_bytes(b"")
    with pytest.raises(DataError, match=r"scenes\.npz: not a whole file of training data"):
        load_scenes(path)
    np.savez(path, format="uncle senfunet scenes", scenes=1, sensors=["a"])
    with pytest.raises(DataError, match="is missing"):
        load_scenes(path)


def test_what_is_needed_is_named(source):
    with pytest.raises(ConfigError, match="has no sensor 'tof'"):
        collect_scene("box", source, ("tof",), 2, 0.08, 5)
    bare = SimpleNamespace(sensors=("gt", "good"), reference_mesh=None)
    with pytest.raises(DataError, match="has no reference mesh"):
        collect_scene("box", bare, ("good",), 2, 0.08, 5)
