import cv2
import numpy as np
import pytest
from uncle.datasets.calibration import Calibration
from uncle.datasets.depth_units import DepthUnits
from uncle.datasets.images import Undistorter, list_files, read_color, read_depth
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import DataError

CAMERA = Camera(8, 6, 5.0, 5.0, 3.5, 2.5)


def test_files_are_sorted_as_people_count(tmp_path):
    for name in ("10.png", "9.png", "a2.jpg", "a10.JPG", ".hidden.png", "notes.txt"):
        (tmp_path / name).touch()
    assert list(list_files(tmp_path)) == ["a2", "a10", "9", "10"]
    assert list_files(tmp_path / "absent") == {}


def test_depth_values_and_both_kinds_of_hole(tmp_path):
    values = np.full((6, 8), 2500, np.uint16)
    values[0, 0], values[0, 1] = 0, 65535
    cv2.imwrite(str(tmp_path / "d.png"), values)
    depth = read_depth(tmp_path / "d.png", CAMERA, DepthUnits(5000.0))
    assert depth.dtype == np.float32
    assert depth[0, :3].tolist() == [0.0, 0.0, 0.5]


def test_depth_with_three_channels_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "d.png"), np.full((6, 8, 3), (1, 2, 3), np.uint16))
    with pytest.raises(DataError, match="expected one channel"):
        read_depth(tmp_path / "d.png", CAMERA, DepthUnits(1000.0))


@pytest.mark.parametrize("image", [np.full((6, 8, 3), (10, 20, 30)), np.full((6, 8, 4), (10, 20, 30, 255))])
def test_colour_is_rgb_without_alpha(tmp_path, image):
    cv2.imwrite(str(tmp_path / "c.png"), image.astype(np.uint8))  # OpenCV writes BGR
    assert read_color(tmp_path / "c.png", CAMERA)[0, 0].tolist() == [30, 20, 10]


def test_grey_colour_gets_three_channels(tmp_path):
    cv2.imwrite(str(tmp_path / "c.png"), np.full((6, 8), 7, np.uint8))
    assert read_color(tmp_path / "c.png", CAMERA).shape == (6, 8, 3)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("keep", [0.0, 0.5, 0.9])
def test_truncated_image_is_an_error(tmp_path, suffix, keep):
    path = tmp_path / f"c{suffix}"
    cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 255, (60, 80, 3), dtype=np.uint8))
    data = path.read_bytes()
    path.write_bytes(data[: int(keep * len(data))])
    with pytest.raises(DataError, match=path.name):
        read_color(path, Camera(80, 60, 50.0, 50.0, 40.0, 30.0))


def test_undistortion_never_mixes_depths():
    calibration = Calibration(Camera(80, 60, 50.0, 50.0, 40.0, 30.0), distortion=(0.3, -0.2, 0.01, 0.0))
    depth = np.where(np.add.outer(np.arange(60), np.arange(80)) % 7 < 3, 1.0, 2.0).astype(np.float32)
    straight = Undistorter(calibration.camera, calibration.distortion).depth(depth)
    assert set(np.unique(straight)) <= {0.0, 1.0, 2.0}
    assert (straight != depth).mean() > 0.1


def test_missing_image_is_an_error(tmp_path):
    with pytest.raises(DataError, match=r"gone\.png"):
        read_depth(tmp_path / "gone.png", CAMERA, DepthUnits(1000.0))
