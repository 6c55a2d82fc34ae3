"""Training of the confidence network: its loss, its data file, and that it learns."""

import math

import numpy as np
import pytest
import torch
from uncle.recon.core.errors import ConfigError, DataError
from uncle.recon.methods.confidence.network import confidence_image
from uncle.recon.methods.pretrain.confidence import ConfidenceTraining, confidence_loss, held_out, train_confidence
from uncle.recon.methods.pretrain.depth_pairs import DepthPairs, packed, spread, unpacked


class Wall:
    """A recording of a slanted wall whose sensor is off by 30 cm in the right half of the image."""

    sensors = ("gt", "half")

    def __init__(self, frames: int = 3) -> None:
        self.frames = frames

    def __len__(self) -> int:
        return self.frames

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        depth = torch.linspace(1.5, 2.5, 48).repeat(48, 1) + 0.05 * index
        if sensor == "half":
            depth[:, 24:] += 0.3
        return depth


def plain_loss(s, reading, truth, mask, penalty) -> float:
    """The formula, pixel by pixel."""
    height, width = s.shape
    sobel = np.array([[-1, 0, 1], [-2, 0, 2], [-1, 0, 1]]) / 8
    total, count = 0.0, 0
    error = np.where(mask, reading - truth, 0)
    for y in range(height):
        for x in range(width):
            if not mask[y, x]:
                continue
            slope = 0.0
            if 0 < y < height - 1 and 0 < x < width - 1:
                window, whole = error[y - 1 : y + 2, x - 1 : x + 2], mask[y - 1 : y + 2, x - 1 : x + 2].all()
                slope = whole * (abs((window * sobel).sum()) + abs((window * sobel.T).sum()))
            total += math.exp(-s[y, x]) * (abs(error[y, x]) + slope) + penalty * s[y, x]
            count += 1
    return min(total / count, 10.0)


def test_the_loss_is_the_formula():
    rng = np.random.default_rng(0)
    s, reading, truth = rng.uniform(0, 2, (9, 11)), rng.uniform(1, 3, (9, 11)), rng.uniform(1, 3, (9, 11))
    mask = rng.uniform(size=(9, 11)) < 0.9
    tensors = [torch.from_numpy(values)[None, None] for values in (s, reading, truth, mask)]
    found = confidence_loss(*tensors, 0.06)
    assert float(found) == pytest.approx(plain_loss(s, reading, truth, mask, 0.06), rel=1e-6)


def test_the_loss_is_capped():
    one = torch.ones(1, 1, 8, 8)
    assert float(confidence_loss(0 * one, 100 * one, one, one.bool(), 0.06)) == 10.0


def test_the_best_confidence_is_the_penalty_over_the_error():
    """Where the error e is constant: d/ds (exp(-s) e + lambda s) = 0 at exp(-s) = lambda / e."""
    one = torch.ones(1, 1, 9, 9)
    s = torch.tensor(1.0, requires_grad=True)
    optimizer = torch.optim.Adam([s], lr=0.05)
    for _ in range(400):
        optimizer.zero_grad()
        confidence_loss(s * one, 2.12 * one, 2 * one, one.bool(), 0.06).backward()
        optimizer.step()
    # The error seems to change at the border of the image only, where the window of the gradient is not whole.
    assert math.exp(-s.item()) == pytest.approx(0.5, abs=0.01)


def test_it_learns_where_the_sensor_errs():
    pairs = DepthPairs.collect([("a", Wall()), ("b", Wall(1))], "half", 10)
    settings = ConfidenceTraining(steps=60, batch=1, crop_px=40, learning_rate=6e-4)
    trained = train_confidence(pairs, settings)
    assert min(trained.validation) < 0.95 * trained.validation[0]
    confidence = confidence_image(trained.network, Wall().depth(0, "half"))
    assert float(confidence[:, 30:38].mean()) < 0.85 * float(confidence[:, 12:20].mean())
    assert trained.recipe(pairs, settings)["recordings"] == 2


def test_the_same_seed_gives_the_same_network():
    pairs = DepthPairs.collect([("a", Wall(2))], "half", 10)
    settings = ConfidenceTraining(steps=3, batch=1, crop_px=32, seed=5)
    first, second = (train_confidence(pairs, settings).network.state_dict() for _ in range(2))
    assert all(torch.equal(first[key], second[key]) for key in first)


def test_what_is_held_back():
    assert held_out(np.array([0, 0, 1, 1])).tolist() == [False, False, True, True]
    assert held_out(np.zeros(10)).sum() == 2
    with pytest.raises(DataError, match="two frames"):
        train_confidence(DepthPairs.collect([("a", Wall(1))], "half", 1), ConfidenceTraining(steps=1))


def test_images_that_are_too_small_are_refused():
    small = DepthPairs("a", *np.ones((2, 3, 18, 18), np.uint16), np.arange(3))
    with pytest.raises(ConfigError, match="too small"):
        train_confidence(small, ConfidenceTraining(steps=1))


def test_the_data_file_gives_the_images_back(tmp_path):
    pairs = DepthPairs.collect([("a", Wall())], "half", 2)
    assert pairs.scene.tolist() == [0, 0]
    pairs.save(tmp_path / "pairs.npz")
    loaded = DepthPairs.load(tmp_path / "pairs.npz")
    assert loaded.sensor == "half"
    np.testing.assert_array_equal(loaded.reading, pairs.reading)
    np.testing.assert_array_equal(loaded.truth, pairs.truth)


def test_packing_is_exact_for_all_values():
    images = np.random.default_rng(0).integers(0, 65536, (2, 5, 300), dtype=np.uint16)
    np.testing.assert_array_equal(unpacked(packed(images)), images)


def test_a_broken_data_file_is_named(tmp_path):
    path = tmp_path / "pairs.npz"
    path.write_bytes(b"PK no zip")
    with pytest.raises(DataError, match=r"pairs\.npz: not a whole file"):
        DepthPairs.load(path)
    np.savez(path, other=np.zeros(3))
    with pytest.raises(DataError, match="not a file of training data of this kind"):
        DepthPairs.load(path)


def test_a_recording_without_truth_is_named():
    with pytest.raises(ConfigError, match=r"a has no sensor 'other', only gt, half"):
        DepthPairs.collect([("a", Wall())], "other", 2)


def test_frames_are_spread_evenly():
    assert spread(10, 3) == [0, 4, 9]
    assert spread(2, 5) == [0, 1]
