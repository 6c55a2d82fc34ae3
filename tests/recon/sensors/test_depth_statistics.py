"""Range, fill and pixel noise of depth images."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from uncle.recon.core.errors import DataError
from uncle.recon.sensors.depth_statistics import depth_facts, pixel_noise


class Images:
    def __init__(self, *depths):
        self.depths = depths

    def depth(self, index, sensor):
        if self.depths[index] is None:
            raise DataError("cannot be read")
        return torch.from_numpy(np.asarray(self.depths[index], np.float32))


def plane(noise_m=0.0, seed=0):
    x, y = np.meshgrid(np.arange(80), np.arange(60))
    return 2.0 + 0.01 * x + 0.005 * y + np.random.default_rng(seed).normal(0, noise_m, x.shape)


@pytest.mark.parametrize("noise_m", [0.0, 0.002, 0.02])
def test_noise_of_a_slanted_plane_is_that_of_its_pixels(noise_m):
    assert pixel_noise(plane(noise_m)) == pytest.approx(noise_m, rel=0.05, abs=1e-9)


def test_facts_leave_out_what_is_unknown_or_too_far():
    half = plane()
    half[:, :40] = 0
    facts = depth_facts(Images(half, np.zeros((60, 80)), None, np.full((60, 80), 9.0)), "a", range(4), max_depth_m=6.0)
    assert (facts.fill, facts.empty, facts.images) == (0.0, 3, 4)
    assert facts.quantiles[1] == pytest.approx(np.median(half[half > 0]), abs=0.01)
    assert facts.quantiles[0] < facts.quantiles[1] < facts.quantiles[2] < 6


def test_images_without_any_depth_have_no_facts():
    assert depth_facts(Images(np.zeros((4, 4)), None), "a", range(2)) is None
    assert np.isnan(pixel_noise(np.zeros((4, 4))))
