"""Displacement of colour against depth, on boxes whose outlines are known."""

import cv2
import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.evaluation.inspection.registration import measure_registration


class Boxes:
    """Bright boxes at 1 m before a darker wall at 2 m, at other places in each frame; colour moved or scaled."""

    camera, sensors = Camera(320, 240, 260.0, 260.0, 159.5, 119.5), ("depth",)

    def __init__(self, shift=(0, 0), scale=1.0):
        self.shift, self.scale = shift, scale

    def __len__(self):
        return 12

    def _mask(self, index):
        rng = np.random.default_rng(index)
        mask = np.zeros((240, 320), bool)
        for _ in range(5):
            x, y, w, h = rng.integers([20, 20, 20, 20], [260, 180, 60, 60])
            mask[y : y + h, x : x + w] = True
        return mask

    def color(self, index):
        rng = np.random.default_rng(100 + index)
        texture = cv2.GaussianBlur(rng.normal(0, 40, (240, 320)), (0, 0), 2.0)
        gray = np.where(self._mask(index), 170, 80) + texture
        image = np.repeat(np.clip(gray, 0, 255).astype(np.uint8)[..., None], 3, 2)
        x, y = self.shift
        matrix = np.array([[self.scale, 0, x + 160 * (1 - self.scale)], [0, self.scale, y + 120 * (1 - self.scale)]])
        return torch.from_numpy(cv2.warpAffine(image, matrix, (320, 240), borderMode=cv2.BORDER_REPLICATE))

    def depth(self, index, sensor):
        return torch.from_numpy(np.where(self._mask(index), 1.0, 2.0).astype(np.float32))


@pytest.mark.parametrize("shift", [(0, 0), (8, 0), (0, -8), (-5, 11)], ids=str)
def test_a_displacement_is_measured(shift):
    found = measure_registration(Boxes(shift), ["depth"], range(12))["depth"]
    assert np.hypot(found.x - shift[0], found.y - shift[1]) <= 1.5
    assert found.scale == 1.0
    assert found.height > 6


def test_colour_of_another_calibration_is_larger():
    found = measure_registration(Boxes(scale=1.15), ["depth"], range(12))["depth"]
    assert found.scale == pytest.approx(1.15, abs=0.05)


def test_a_plane_has_no_outlines():
    boxes = Boxes()
    boxes.depth = lambda index, sensor: torch.full((240, 320), 2.0)
    assert measure_registration(boxes, ["depth"], range(12)) == {}
