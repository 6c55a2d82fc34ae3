"""Image files of recordings: finding them in order, reading them with checks, removing lens distortion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

from ..recon.core.camera import Camera
from ..recon.core.depth_image import DEPTH_SUFFIXES, read_depth_values
from ..recon.core.errors import DataError
from ..recon.core.files import read_image
from .depth_units import DepthUnits
from .names import sorted_names

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
SIZE_SAMPLES = 4  # images after the first whose size is read: one of them may be damaged or odd


def list_files(folder: Path, suffixes: tuple[str, ...] = IMAGE_SUFFIXES) -> dict[str, Path]:
    """File stem -> path of the files with one of `suffixes`, in natural order; empty if there is no such folder.

    Of several files of one stem the one whose suffix comes first in `suffixes` is taken.
    """
    if not folder.is_dir():
        return {}
    found = [path for path in folder.iterdir() if path.suffix.lower() in suffixes and path.name[0] != "."]
    found.sort(key=lambda path: (suffixes.index(path.suffix.lower()), path.name), reverse=True)
    files = {path.stem: path for path in found}
    return {stem: files[stem] for stem in sorted_names(files)}


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
    numbered = {int(number): path for number, path in matches.items() if number.isdecimal()}
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


def usual_size(files: Sequence[Path], stated: Camera) -> tuple[int, int]:
    """(width, height) of most of a few of `files`; as `stated` if none can be read or there is no majority."""
    last = len(files) - 1
    chosen = (
        [files[index] for index in sorted({n * last // SIZE_SAMPLES for n in range(SIZE_SAMPLES + 1)})] if files else []
    )
    sizes: Counter[tuple[int, int]] = Counter()
    for file in chosen:
        with suppress(DataError):  # reported when the frame is read
            sizes[read_size(file)] += 1
    size, count = sizes.most_common(1)[0] if sizes else ((stated.width, stated.height), 1)
    return size if 2 * count > sizes.total() else (stated.width, stated.height)


def _require_size(path: Path, image: np.ndarray, camera: Camera) -> None:
    height, width = image.shape[:2]
    if (width, height) != (camera.width, camera.height):
        raise DataError(f"{path} has the wrong size: expected {camera.width}x{camera.height}, found {width}x{height}")


class Undistorter:
    """Resamples images to the pinhole camera of the same intrinsics; does nothing where there is no distortion."""

    def __init__(self, camera: Camera, distortion: tuple[float, ...], is_fisheye: bool = False) -> None:
        """`distortion` has OpenCV's coefficients (k1, k2, p1, p2[, k3[, k4, k5, k6]]), or is empty.

        With `is_fisheye` they are k1 to k4 of OpenCV's fisheye model, which is not the identity where they are zero.
        """
        self._maps: tuple[np.ndarray, np.ndarray] | None = None
        if any(distortion) or (is_fisheye and distortion):
            size, rotation = (camera.width, camera.height), np.eye(3)
            compute = cv2.fisheye.initUndistortRectifyMap if is_fisheye else cv2.initUndistortRectifyMap
            self._maps = compute(camera.matrix, np.array(distortion), rotation, camera.matrix, size, cv2.CV_32FC1)
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
