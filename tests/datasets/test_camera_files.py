import json

import cv2
import numpy as np
import pytest
from uncle.datasets.calibration import Calibration, CameraFile
from uncle.datasets.camera_files import calibration_or
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import DataError

CAMERA = Camera(64, 48, 50.0, 52.0, 30.0, 25.0)
DEFAULT = Calibration(Camera(640, 480, 1.0, 1.0, 0.0, 0.0), 5000.0)
FIELDS = {"width": 64, "height": 48, "fx": 50, "fy": 52, "cx": 30, "cy": 25}
MATRIX = "50 0 30\n0 52 25\n0 0 1\n"
COLUMNS = [50, 0, 0, 0, 52, 0, 30, 25, 1]
INFO = """m_versionNumber = 4
m_colorWidth = 64
m_colorHeight = 48
m_depthWidth = 64
m_depthHeight = 48
m_depthShift = 2000
m_calibrationColorIntrinsic = {color} 0 30 0 0 52 25 0 0 0 1 0 0 0 0 1
m_calibrationColorExtrinsic = 1 0 0 {shift} 0 1 0 0 0 0 1 0 0 0 0 1
m_calibrationDepthIntrinsic = 50 0 30 0 0 52 25 0 0 0 1 0 0 0 0 1
"""


@pytest.fixture
def read(tmp_path):
    """Text of a file of this name -> the calibration; depth images are 64x48."""
    cv2.imwrite(str(tmp_path / "depth.png"), np.ones((48, 64), np.uint16))

    def run(name, text):
        (tmp_path / name).write_text(text)
        return calibration_or([tmp_path / "nothing", tmp_path], DEFAULT, [tmp_path / "depth.png"])

    return run


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("camera-intrinsics.txt", MATRIX),
        ("camera-intrinsics.txt", MATRIX.replace(" ", "\t").replace("\n", "\r\n")),
        ("intrinsics.txt", "50,0 0,0 30,0 0\n0 52,0 25,0 0\n0 0 1 0\n0 0 0 1"),
        ("intrinsic.txt", "50 0 30 0 52 25 0 0 1"),
        ("calibration.txt", "50 52 30 25"),
        ("camera_primesense.json", json.dumps({"width": 64, "height": 48, "intrinsic_matrix": COLUMNS})),
        (
            "intrinsic.json",
            json.dumps({"width": 64, "height": 48, "intrinsic_matrix": [50, 0, 30, 0, 52, 25, 0, 0, 1]}),
        ),
        ("camera.json", "\ufeff" + json.dumps({"width": 64, "height": 48, "intrinsic_matrix": COLUMNS})),
    ],
)
def test_files_of_other_tools_state_the_camera(read, name, text):
    calibration, notes = read(name, text)
    assert calibration == Calibration(CAMERA, 5000.0)
    assert notes == (f"intrinsics are those of {name}",)


def test_distortion_behind_the_four_numbers_of_a_camera(read):
    calibration, _ = read("calibration.txt", "50 52 30 25 0.1 -0.2 0.01 0.02")
    assert (calibration.camera, calibration.distortion) == (CAMERA, (0.1, -0.2, 0.01, 0.02))


def test_info_of_bundlefusion(read):
    assert read("info.txt", INFO.format(color=50, shift=0))[0] == Calibration(CAMERA, 2000.0)
    other, _ = read("info.txt", INFO.format(color=55, shift=0))
    assert other.color_camera == Camera(64, 48, 55.0, 52.0, 30.0, 25.0)
    np.testing.assert_array_equal(other.T_color_depth, np.eye(4))
    with pytest.raises(DataError, match="m_calibrationColorExtrinsic moves the camera"):
        read("info.txt", INFO.format(color=50, shift=0.02))
    with pytest.raises(DataError, match="expected m_calibrationColorIntrinsic = 16 numbers"):
        read("info.txt", INFO.format(color="x", shift=0))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("intrinsics.txt", "50 52\n", "line 1: expected a 3x3 intrinsic matrix"),
        ("intrinsics.txt", "50 7 30\n3 52 25\n0 0 1", "has the rows `fx 0 cx`"),
        ("calibration.txt", "-50 52 30 25", "fx and fy must be positive"),
        ("camera.json", '{"width": 64, "height": 48, "intrinsic_matrix": [1, 2]}', "3x3 numbers"),
        ("camera.json", json.dumps(FIELDS | {"width": 10**30}), "width: Input should be less than"),
        ("camera.json", json.dumps(FIELDS | {"fx": 1e300}), "fx: Input should be less than"),
        ("camera.json", json.dumps(FIELDS | {"depth_scale": 1e300}), "depth_scale: Input should be less than"),
        ("camera.json", "[" * 5000, r"^.{,600}\(fields are described"),
        ("info.txt", INFO.format(color=50, shift=0).replace("2000", "0"), "m_depthShift = 0 is no number of depth"),
    ],
)
def test_what_is_no_camera_is_named(read, name, text, message):
    with pytest.raises(DataError, match=message):
        read(name, text)


def test_several_json_files_are_refused(read, tmp_path):
    text = json.dumps({"width": 64, "height": 48, "intrinsic_matrix": COLUMNS})
    (tmp_path / "color_intrinsics.json").write_text(text)
    with pytest.raises(DataError, match=r"several camera files \(color_intrinsics.json, depth_intrinsics.json\)"):
        read("depth_intrinsics.json", text)


@pytest.mark.parametrize(("value", "written"), [(0.001, "1000"), (0.00025, "4000"), (0.0002, "5000")])
def test_an_inverted_depth_scale_names_the_value_to_write(tmp_path, value, written):
    (tmp_path / "camera.json").write_text(json.dumps(FIELDS | {"depth_scale": value}))
    with pytest.raises(DataError, match=rf'is inverted: .* is "depth_scale": {written} '):
        CameraFile.load(tmp_path / "camera.json")


@pytest.mark.parametrize(
    ("model", "count", "is_fisheye"),
    [(None, 8, False), ("opencv", 14, False), ("rational_polynomial", 8, False), ("plumb_bob", 5, False),
     ("fisheye", 4, True), ("opencv_fisheye", 4, True), ("equidistant", 4, True)],
)  # fmt: skip
def test_models_of_distortion(tmp_path, model, count, is_fisheye):
    fields = FIELDS | {"distortion": [0.01] * count} | ({"distortion_model": model} if model else {})
    (tmp_path / "camera.json").write_text(json.dumps(fields))
    calibration = CameraFile.load(tmp_path / "camera.json").calibration()
    assert (calibration.distortion, calibration.is_fisheye) == ((0.01,) * count, is_fisheye)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"distortion": [0.1] * 6}, "k1, k2, p1, p2.*found 6 numbers"),
        ({"distortion": [0.1] * 5, "distortion_model": "fisheye"}, "k1, k2, k3, k4, found 5 numbers"),
        ({"distortion": [0.1] * 5, "distortion_model": "inverse_brown_conrady"}, "is none of opencv"),
    ],
)
def test_unknown_distortion_is_named(tmp_path, fields, message):
    (tmp_path / "camera.json").write_text(json.dumps(FIELDS | fields))
    with pytest.raises(DataError, match=message):
        CameraFile.load(tmp_path / "camera.json")
