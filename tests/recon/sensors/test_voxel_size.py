"""A voxel size that fits the depth and the noise of a recording."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from uncle.recon.sensors.depth_statistics import DepthFacts
from uncle.recon.sensors.voxel_size import choose_voxel_size, fitting_voxel_size, in_series


def facts(median, noise_m=0.0, background=None):
    return DepthFacts((0.6 * median, median, background or 1.6 * median), noise_m, 1.0, 0, 10)


@pytest.mark.parametrize(
    ("median", "expected_m"),
    [(0.1, 0.001), (0.3, 0.002), (0.5, 0.005), (0.75, 0.01), (0.9, 0.02), (2.0, 0.02), (3.5, 0.02), (5.0, 0.05)],
)
def test_rooms_have_two_centimetres_and_other_scenes_what_fits_their_depth(median, expected_m):
    assert fitting_voxel_size([facts(median)]).size_m == pytest.approx(expected_m)


def test_the_voxel_is_not_smaller_than_the_noise_or_what_the_background_needs():
    noisy, open_view = facts(0.5, noise_m=0.009), facts(0.3, background=4.0)
    assert fitting_voxel_size([noisy]).size_m == 0.01
    assert "noise" in fitting_voxel_size([noisy]).reason
    assert fitting_voxel_size([noisy, facts(0.5)]).size_m == 0.005  # the better sensor resolves it
    assert fitting_voxel_size([open_view]).size_m == 0.01
    assert "background at 4.0 m" in fitting_voxel_size([open_view]).reason
    assert fitting_voxel_size([facts(0.5, noise_m=0.1)]).size_m == 0.02  # no coarser than a room


def test_nothing_known_is_a_room():
    assert fitting_voxel_size([]).size_m == 0.02


@pytest.mark.parametrize(("size_m", "expected_m"), [(0.0029, 0.002), (0.0033, 0.005), (0.0080, 0.01), (9.0, 0.5)])
def test_series(size_m, expected_m):
    assert in_series(size_m) == pytest.approx(expected_m)


def test_the_middle_of_the_sensors_and_images_over_the_whole_recording_decide():
    class Images:
        def depth(self, index, sensor):
            depth = {"near": 0.1, "middle": 0.5 if index > 20 else 0.4, "far": 5.0}[sensor]
            return torch.from_numpy(np.full((8, 8), depth, np.float32))

    assert choose_voxel_size(Images(), 100, ("near", "middle", "far"), 6.0).size_m == 0.005
    assert choose_voxel_size(Images(), 1, ("far",), 6.0).size_m == 0.05
    assert choose_voxel_size(Images(), 1, ("far",), 4.0).size_m == 0.02  # nothing within the range
