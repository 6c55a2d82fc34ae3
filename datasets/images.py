"""Image files of recordings: finding them in order, reading them with checks, removing lens distortion."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np

from ..recon.core.camera import Camera
from ..recon.core.depth_image import DEPTH_SUFFIXES, read_depth_values
from ..recon.core.errors import DataError
from ..recon.core.files import read_image
from .depth_units import DepthUnits

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
SATURATED = 65535  # the largest value of a 16-bit image is never a measurement; Kinect recordings mark holes by it


def natural_key(name: str) -> tuple[tuple[int, str], ...]:
    """Sort key by which `frame2` precedes `frame10`."""
    return tuple((int(part), "") if part.isdigit() else (-1, part) for part in re.findall(r"\d+|\D+", name))


def list_files(folder: Path, suffixes: tuple[str, ...] = IMAGE_SUFFIXES) -> dict[str, Path]:
    """File stem -> path of the files with one of `suffixes`, in natural order; empty if there is no such folder."""
    if not folder.is_dir():
        return {}
    files = {path.stem: path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.name[0] != "."}
    return {stem: files[stem] for stem in sorted(files, key=natural_key)}


def list_depth_files(folder: Path) -> dict[str, Path]:
    """File stem -> depth image of any format that is read, in natural order.

    Raises DataError if there are files of other formats alone, or a stem has two.
    """
    files = list_files(folder, DEPTH_SUFFIXES)
    others = [path.name for path in folder.iterdir() if path.name[0] != "."] if folder.is_dir() and not files else []
    if others:
        formats = ", ".join(DEPTH_SUFFIXES)
        raise DataError(f"{folder} holds no depth images ({formats}), but {len(others)} others such as {min(others)}")
    if folder.is_dir():
        for path in sorted(folder.iterdir()):
            if path.suffix.lower() in DEPTH_SUFFIXES and path.name[0] != "." and path != files[path.stem]:
                names = " and ".join(sorted((path.name, files[path.stem].name)))
                raise DataError(f"{folder} holds {names}: it cannot be told which is the depth image; move one away")
    return files


def list_numbered(folder: Path, prefix: str, suffixes: tuple[str, ...] = IMAGE_SUFFIXES) -> dict[int, Path]:
    """Number -> path of the files called `<prefix><number><suffix>`, in order."""
    matches = {
        stem[len(prefix) :]: path for stem, path in list_files(folder, suffixes).items() if stem.startswith(prefix)
    }
    numbered = {int(number): path for number, path in matches.items() if number.isdigit()}
    return {number: numbered[number] for number in sorted(numbered)}


def read_color(path: Path, camera: Camera, resize: bool = False) -> np.ndarray:
    """(H, W, 3) uint8 RGB; `resize` brings images of another size to the camera's. Raises DataError."""
    # A rotation flag in the file is ignored: the depth image and the intrinsics know nothing of it.
    image = read_image(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
    if resize and image.shape[:2] != (camera.height, camera.width):
        image = cv2.resize(image, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    _require_size(path, image, camera)
    return image


def read_depth(path: Path, camera: Camera, units: DepthUnits) -> np.ndarray:
    """(H, W) float32 z-depth in metres, 0 where there is no measurement. Raises DataError."""
    values = read_depth_values(path)
    _require_size(path, values, camera)
    return units.metres(values)


def read_size(path: Path) -> tuple[int, int]:
    """(width, height) in pixels. Raises DataError."""
    if path.suffix.lower() in IMAGE_SUFFIXES:
        height, width = read_image(path, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION).shape[:2]
    else:
        height, width = read_depth_values(path).shape
    return width, height


def _require_size(path: Path, image: np.ndarray, camera: Camera) -> None:
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise DataError(f"{path} has the wrong size: expected {camera.width}x{camera.height}, found {width}x{height}")


class Undistorter:
    """Resamples images to the pinhole camera of the same intrinsics; does nothing where there is no distortion."""

    def __init__(self, camera: Camera, distortion: tuple[float, ...]) -> None:
        """`distortion` is OpenCV's (k1, k2, p1, p2[, k3]), or empty."""
        self._maps: tuple[np.ndarray, np.ndarray] | None = None
        if any(distortion):
            self._maps = cv2.initUndistortRectifyMap(
                camera.matrix, np.array(distortion), None, camera.matrix, (camera.width, camera.height), cv2.CV_32FC1
            )
            self._fast_maps = cv2.convertMaps(*self._maps, cv2.CV_16SC2)  # fixed point: colour in half the time

    def color(self, image: np.ndarray) -> np.ndarray:
        """Bilinear; pixels that the lens did not see repeat the border."""
        if self._maps is None:
            return image
        return cv2.remap(image, *self._fast_maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def depth(self, image: np.ndarray) -> np.ndarray:
        """Nearest neighbour, because a mean of two depths is on neither surface; 0 where the lens did not see."""
        if self._maps is None:
            return image
        return cv2.remap(image, *self._maps, cv2.INTER_NEAREST, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
