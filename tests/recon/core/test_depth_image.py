"""Depth images of every format hold the same values."""

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from uncle.recon.core.depth_image import read_depth_values
from uncle.recon.core.errors import DataError

RNG = np.random.default_rng(0)
METRES = (0.5 + 4 * RNG.random((30, 40))).astype(np.float32)
METRES[0, :4] = np.nan, np.inf, -np.inf, -1.0
EXPECTED = np.where(np.isfinite(METRES) & (METRES > 0), METRES, 0)
UNITS = (EXPECTED * 1000).astype(np.uint16)
UNITS[1, 0] = 65535
COLORS = np.stack([EXPECTED, EXPECTED * 0, EXPECTED], axis=2)


def save_exr(path, channels):
    OpenEXR.File({"type": OpenEXR.scanlineimage}, channels).write(str(path))


WRITE_REAL = {
    "d.tiff": lambda path: cv2.imwrite(str(path), METRES),
    "double.tif": lambda path: cv2.imwrite(str(path), METRES.astype(np.float64)),
    "deflated.tif": lambda path: tifffile.imwrite(path, METRES, compression="zlib"),
    "d.pfm": lambda path: cv2.imwrite(str(path), METRES),
    "d.exr": lambda path: save_exr(path, {"Z": METRES}),
    "grey.exr": lambda path: save_exr(path, {"R": METRES, "G": METRES, "B": METRES}),
    "with_color.exr": lambda path: save_exr(path, {"RGB": COLORS, "Z": METRES}),
    "d.npy": lambda path: np.save(path, METRES),
    "double.npy": lambda path: np.save(path, METRES[..., None].astype(np.float64)),
    "d.npz": lambda path: np.savez(path, METRES),
    "more.npz": lambda path: np.savez_compressed(path, depth=METRES, color=UNITS),
}
WRITE_INTEGER = {
    "d.png": lambda path: cv2.imwrite(str(path), UNITS),
    "d.tif": lambda path: cv2.imwrite(str(path), UNITS),
    "motorola.tif": lambda path: tifffile.imwrite(path, UNITS, byteorder=">"),
    "d.pgm": lambda path: cv2.imwrite(str(path), UNITS),
    "ascii.pgm": lambda path: path.write_text(f"P2\n40 30\n65535\n{' '.join(map(str, UNITS.ravel()))}\n"),
    "d.npy": lambda path: np.save(path, UNITS),
    "d.npz": lambda path: np.savez(path, depth=UNITS),
    "grey.png": lambda path: cv2.imwrite(str(path), np.repeat(UNITS[..., None], 3, axis=2)),
}


@pytest.mark.parametrize("name", WRITE_REAL)
def test_float_values(tmp_path, name, recwarn):
    with np.errstate(invalid="ignore"):
        WRITE_REAL[name](tmp_path / name)
    recwarn.clear()
    values = read_depth_values(tmp_path / name)
    assert values.dtype == np.float32
    np.testing.assert_array_equal(values, EXPECTED)
    assert not recwarn.list


@pytest.mark.parametrize("name", WRITE_INTEGER)
def test_integer_values(tmp_path, name):
    WRITE_INTEGER[name](tmp_path / name)
    values = read_depth_values(tmp_path / name)
    assert values.dtype == np.uint16
    np.testing.assert_array_equal(values, np.where(UNITS == 65535, 0, UNITS))


@pytest.mark.parametrize("kind", [np.float16, np.int16, np.int32, np.uint32, np.int64])
@pytest.mark.parametrize("suffix", [".npy", ".tif"])
def test_values_of_other_types(tmp_path, kind, suffix):
    values = np.array([[0, 1, 2000, -5]] * 4).astype(kind)
    if suffix == ".npy":
        np.save(tmp_path / "d.npy", values)
    else:
        tifffile.imwrite(tmp_path / "d.tif", values)
    expected = [0, 1, 2000, 0 if np.issubdtype(kind, np.signedinteger) or kind == np.float16 else 2**31 - 1]
    assert read_depth_values(tmp_path / f"d{suffix}")[0].tolist() == expected


@pytest.mark.parametrize("name", [*WRITE_REAL, *WRITE_INTEGER])
@pytest.mark.parametrize("keep", [0.0, 0.1, 0.7])
def test_a_cut_file_is_an_error_that_names_it(tmp_path, name, keep):
    {**WRITE_REAL, **WRITE_INTEGER}[name](tmp_path / name)
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(data[: int(keep * len(data))])
    with pytest.raises(DataError, match=name):
        read_depth_values(tmp_path / name)


@pytest.mark.parametrize(
    ("name", "write", "message"),
    [
        ("d.png", lambda path: cv2.imwrite(str(path), np.ones((9, 9), np.uint8)), "is 8-bit"),
        ("d.npy", lambda path: np.save(path, np.ones((9, 9), np.uint8)), "is 8-bit"),
        ("d.npy", lambda path: np.save(path, np.array([{}]), allow_pickle=True), "not a whole NPY file"),
        ("d.npy", lambda path: np.save(path, np.ones((9, 9), complex)), "complex numbers"),
        ("d.npy", lambda path: np.save(path, np.ones((4, 9, 9))), "expected one channel"),
        ("d.npz", lambda path: np.savez(path, a=UNITS, b=UNITS), "holds a, b; call the array of depth `depth`"),
        ("d.exr", lambda path: save_exr(path, {"A": EXPECTED, "N": EXPECTED}), "has the channels A, N"),
        ("d.exr", lambda path: save_exr(path, {"R": EXPECTED, "G": EXPECTED * 2, "B": EXPECTED}), "one channel"),
        ("d.exr", lambda path: path.write_text("no image"), "not a whole EXR image"),
        ("d.png", lambda _: None, "cannot read"),
        ("d.pgm", lambda path: path.write_bytes(b"P5\n9999999 9999999\n65535\n" + bytes(99)), "not a whole image"),
        ("d.npy", lambda path: path.write_bytes(b"\x93NUMPY\x01\x00\x10\x00{'descr': '<f4',"), "not a whole NPY file"),
    ],
)
def test_what_is_no_depth_image_is_named(tmp_path, name, write, message):
    write(tmp_path / name)
    with pytest.raises(DataError, match=message) as caught:
        read_depth_values(tmp_path / name)
    assert name in str(caught.value)
