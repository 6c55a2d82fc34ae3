"""Depth images of any usual file format, as the numbers that the file holds."""

from __future__ import annotations

import logging
from pathlib import Path

import cv2
import numpy as np

from .array_files import archive_sizes, read_npy, read_npz
from .errors import DataError
from .files import read_image, require_file
from .json_values import first_problem

DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".pgm", ".exr", ".npy", ".npz", ".pfm")
SATURATED = 65535  # the largest value of a 16-bit depth image never is a reading; Kinect recordings mark holes by it
MAX_ARRAY_BYTES = 1 << 30  # of an array in an archive; a larger one is no image
_EXR_CHANNELS = ("Z", "depth.Z", "Depth.Z", "depth", "Depth", "Y", "V")


def read_depth_values(path: Path) -> np.ndarray:
    """(H, W) uint16, int32 or float32 in the unit of the file; 0 where there is no measurement.

    No measurement are 65535 in images of 16 bits, and what is negative or not finite. Raises DataError for anything but
    an image of one channel (or of equal ones) with more than 8 bits.
    """
    suffix = path.suffix.lower()
    readers = {".exr": _read_exr, ".npy": _read_npy, ".npz": _read_npz, ".tif": _read_tiff, ".tiff": _read_tiff}
    values = _one_channel(path, readers.get(suffix, _read_opencv)(path))
    if values.dtype == np.uint8:
        raise DataError(f"{path} is 8-bit; depth must be 16-bit or float (is it a preview picture?)")
    depth: np.ndarray
    if values.dtype == np.uint16:
        depth = np.where(values == SATURATED, np.uint16(0), values)
    elif values.dtype.kind in "iu" and values.dtype != np.int8:
        depth = np.clip(values, 0, np.iinfo(np.int32).max).astype(np.int32)
    elif values.dtype.kind == "f":
        with np.errstate(invalid="ignore", over="ignore"):
            depth = values.astype(np.float32)
        depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0))
    else:
        raise DataError(f"{path} is not a depth image: its values are of type {values.dtype}")
    return depth


def _one_channel(path: Path, image: np.ndarray) -> np.ndarray:
    """(H, W) of an image (H, W), (H, W, 1) or (1, H, W), or of equal channels."""
    if image.ndim == 3 and 1 in (image.shape[0], image.shape[2]):
        image = image[0] if image.shape[0] == 1 else image[..., 0]
    if image.ndim == 3 and image.shape[2] in (3, 4) and image.size and np.array_equal(*_first_three(image)):
        image = image[..., 0]
    if image.ndim != 2 or image.size == 0:
        raise DataError(f"{path} is not a depth image: expected one channel, found {image.shape} {image.dtype}")
    return image


def _first_three(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.nan_to_num(image[..., :1].repeat(2, axis=2)), np.nan_to_num(image[..., 1:3])


def _read_opencv(path: Path) -> np.ndarray:
    return read_image(path, cv2.IMREAD_UNCHANGED)


def _read_tiff(path: Path) -> np.ndarray:
    """By OpenCV, which knows every compression; by tifffile what it does not decode, such as 16-bit floats."""
    try:
        return _read_opencv(path)
    except DataError:
        import tifffile

        logging.getLogger("tifffile").setLevel(logging.CRITICAL)  # it would report what is raised anyway
        try:
            require_file(path)
            with tifffile.TiffFile(path) as file:
                page = file.pages.first
                if page.nbytes > MAX_ARRAY_BYTES or sum(page.databytecounts) > path.stat().st_size:
                    raise ValueError("it states more data than it can have")
                return np.asarray(page.asarray())
        except Exception as error:  # of many types, for a file that is damaged
            raise DataError(f"cannot read {path}: not a whole TIFF image") from error


def _read_npy(path: Path) -> np.ndarray:
    try:
        return read_npy(path)
    except Exception as error:  # of many types, for a header that is damaged
        raise DataError(f"cannot read {path}: not a whole NPY file of numbers ({first_problem(error)})") from error


def _read_npz(path: Path) -> np.ndarray:
    try:
        sizes = archive_sizes(path)
        name = next(iter(sizes)) if len(sizes) == 1 else "depth"
        if name not in sizes:
            raise DataError(f"{path} holds {', '.join(sorted(sizes)) or 'nothing'}; call the array of depth `depth`")
        if sizes[name] > MAX_ARRAY_BYTES:
            raise DataError(f"{path}: {name} has {sizes[name]} bytes unpacked, which is no image")
        return read_npz(path, name)[name]
    except DataError:
        raise
    except Exception as error:  # of many types, for an archive or a header that is damaged
        raise DataError(f"cannot read {path}: not a whole NPZ file of numbers ({error})") from error


def _read_exr(path: Path) -> np.ndarray:
    import OpenEXR  # wheels of OpenCV are built without it

    try:
        require_file(path)
        with OpenEXR.File(str(path)) as file:
            channels = {name: channel.pixels for name, channel in file.channels().items()}
    except (OSError, RuntimeError, ValueError, TypeError, MemoryError) as error:
        raise DataError(f"cannot read {path}: not a whole EXR image") from error
    chosen = [name for name in _EXR_CHANNELS if name in channels]
    chosen += [name for name in channels if name.endswith((".Z", ".z"))]
    name = next(iter(channels)) if len(channels) == 1 else next(iter(chosen), None)
    if name is None:
        raise DataError(f"{path} has the channels {', '.join(sorted(channels))}; name that of depth Z")
    pixels: np.ndarray = channels[name]
    return pixels
