"""Float depth is metres unless its range says otherwise; integers have the unit of the calibration."""

import json

import cv2
import numpy as np
import pytest
from uncle.datasets.depth_units import DepthUnits, sensor_units
from uncle.datasets.registry import open_dataset
from uncle.recon.core.errors import DataError

METRES = np.linspace(0.5, 4, 48 * 64, dtype=np.float32).reshape(48, 64)


def save(folder, values, count=3, suffix=".npy"):
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f"{index:04d}{suffix}" for index in range(count)]
    for file in files:
        np.save(file, values) if suffix == ".npy" else cv2.imwrite(str(file), values)
    return files


@pytest.mark.parametrize(
    ("values", "units_per_m", "real_per_m", "words"),
    [
        (METRES, 1000, 1, "is read as metres"),
        (METRES, 5000, 1, "is read as metres"),
        (METRES, 1, 1, "is read as metres"),
        (METRES * 1000, 1000, 1000, "is read as 1000 units per metre"),
        (METRES * 1000, 1, 1000, "is read as 1000 units per metre"),
        (METRES * 5000, 5000, 5000, "is read as 5000 units per metre"),
        (np.where(METRES < 3.5, METRES, 65504), 1000, 1, "is read as metres"),
        (np.where(METRES < 1.5, METRES, 1e10), 1000, 1, "is read as metres"),
    ],
)
def test_the_range_decides_what_float_values_are(tmp_path, values, units_per_m, real_per_m, words):
    units, notes = sensor_units({"a": save(tmp_path, values.astype(np.float32))}, units_per_m)
    assert units == {"a": DepthUnits(units_per_m, real_per_m)}
    assert len(notes) == 1
    assert notes[0].startswith("sensor a: float depth")
    assert words in notes[0]


def test_integers_have_the_unit_of_the_calibration(tmp_path):
    files = save(tmp_path, (METRES * 5000).astype(np.uint16))
    units, notes = sensor_units({"a": files, "b": []}, 5000)
    assert units == {"a": DepthUnits(5000), "b": DepthUnits(5000)}
    assert notes == ()
    np.testing.assert_allclose(units["a"].metres((METRES * 5000).astype(np.uint16)), METRES, atol=2e-4)


def test_what_renderers_write_for_nothing_is_no_measurement():
    assert DepthUnits(1000).metres(np.array([[2.5, 65504, 1e10]], np.float32)).tolist() == [[2.5, 0, 0]]


@pytest.fixture
def folder(tmp_path):
    """A recording without depth."""
    (tmp_path / "color").mkdir()
    camera = {"width": 64, "height": 48, "fx": 50.0, "fy": 50.0, "cx": 31.5, "cy": 23.5, "depth_scale": 1000}
    (tmp_path / "camera.json").write_text(json.dumps(camera))
    for index in range(3):
        cv2.imwrite(str(tmp_path / f"color/{index:04d}.png"), np.full((48, 64, 3), 90, np.uint8))
    return tmp_path


def test_sensors_of_different_formats_in_one_folder(folder):
    save(folder / "depth_metres", METRES)
    save(folder / "depth_float_mm", METRES * 1000, suffix=".tiff")
    save(folder / "depth_mm", (METRES * 1000).astype(np.uint16), suffix=".png")
    recording = open_dataset(folder)
    assert set(recording.sensors) == {"metres", "float_mm", "mm"}
    for sensor in recording.sensors:
        np.testing.assert_allclose(recording.depth(1, sensor).numpy(), METRES, atol=1.1e-3)
    assert any("sensor metres: float depth is read as metres" in note for note in recording.notes)
    assert any("sensor float_mm: float depth has a median of 2250" in note for note in recording.notes)


def test_two_depth_images_of_one_name_are_refused(folder):
    save(folder / "depth", METRES)
    save(folder / "depth", (METRES * 50).astype(np.uint8), suffix=".png")
    with pytest.raises(DataError, match=r"holds 0000\.npy and 0000\.png: it cannot be told which"):
        open_dataset(folder)


def test_formats_that_are_not_read_are_named(folder):
    (folder / "depth").mkdir()
    (folder / "depth/0000.mat").touch()
    with pytest.raises(DataError, match=r"holds no depth images \(\.png, .*\), but 1 others such as 0000\.mat"):
        open_dataset(folder)
