"""Files that are either whole or absent: everything is written beside its place and renamed into it."""

import errno
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from .errors import DataError, RunError

DEPTH_UNITS_PER_M = 1000.0  # depth PNGs hold millimetres
BETA_UNITS_PER_M = 10000.0  # beta PNGs hold tenths of a millimetre
# Half the time of OpenCV's choice for depth and normals, and no larger.
_FAST_PNG = [cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE, cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB]

# Files that cannot be decoded are errors of ours; OpenCV would print its own besides.
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)

_ADVICE = {
    errno.ENOSPC: "the disk is full; free some space and run the same command again (finished work is kept)",
    errno.EDQUOT: "the disk quota is used up; free some space and run the same command again (finished work is kept)",
    errno.EROFS: "the file system is read-only; choose another place with --run",
    errno.EACCES: "no permission to write there; choose another place with --run",
    errno.ENOTDIR: "a file stands where a folder is needed; choose another place with --run",
}


@contextmanager
def explain_write_errors(path: Path) -> Iterator[None]:
    """Turn an `OSError` raised while writing `path` into a `RunError` that says what to do."""
    try:
        yield
    except OSError as error:
        advice = _ADVICE.get(error.errno or 0, error.strerror or str(error))
        raise RunError(f"cannot write {path}: {advice}") from error


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Yield a temporary name beside `path`; rename it to `path` on success, remove it on failure.

    The temporary name keeps the suffix, because writers choose the format by it. Raises RunError.
    """
    with explain_write_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.stem}.{os.getpid()}.part{path.suffix}")
        try:
            yield temporary
            os.replace(temporary, path)
        finally:
            if temporary.exists():
                temporary.unlink()


def require_file(path: Path) -> None:
    """Raises OSError unless `path` is a file or a folder: a pipe can make a reader wait, a device has no end."""
    try:
        mode = path.stat().st_mode
    except ValueError as error:  # a zero character in the name
        raise OSError(errno.EINVAL, "no file can have this name", str(path)) from error
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise OSError(errno.EINVAL, "it is a pipe or a device; save its content to a file", str(path))


def read_bytes(path: Path) -> bytes:
    """The content of a file. Raises OSError, also for pipes and devices."""
    require_file(path)
    return path.read_bytes()


def read_json(path: Path) -> Any:
    """The value of a JSON file in UTF-8. Raises OSError; ValueError for anything else."""
    try:
        return json.loads(read_bytes(path))
    except RecursionError as error:
        raise ValueError("its brackets are nested too deeply") from error


def write_bytes(path: Path, data: bytes) -> None:
    """Write `data` to `path` in one piece. Raises RunError."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def write_text(path: Path, text: str) -> None:
    """Write `text` to `path` in one piece. Raises RunError."""
    write_bytes(path, text.encode())


def write_image(path: Path, image: np.ndarray, *, png_level: int = 1, jpeg_quality: int = 95) -> None:
    """Write an (H, W) or (H, W, 3) image; colour is RGB. The format follows the suffix. Raises RunError."""
    ordered = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else np.ascontiguousarray(image)
    is_png = path.suffix.lower() == ".png"  # OpenCV warns of options that are not the format's own
    png, jpg = [cv2.IMWRITE_PNG_COMPRESSION, png_level, *_FAST_PNG], [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
    options = png if is_png else jpg
    done, encoded = cv2.imencode(path.suffix, ordered, options)
    if not done:
        raise RunError(f"cannot encode {path}: unsupported image format {path.suffix!r}")
    write_bytes(path, encoded.tobytes())


def read_image(path: Path, flags: int) -> np.ndarray:
    """(H, W) or (H, W, 3) RGB, as OpenCV reads it with `flags`. Raises DataError if it is missing or broken."""
    try:
        data = read_bytes(path)
    except OSError as error:
        raise DataError(f"cannot read {path}: {error.strerror}") from error
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if _is_whole(data) else None
    except cv2.error:  # a size that no image has, for example
        image = None
    if image is None:
        raise DataError(f"cannot read {path}: not a whole image")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB) if image.ndim == 3 else image


def _is_whole(data: bytes) -> bool:
    """Whether an image file reaches its end mark. OpenCV itself returns the readable half of a cut PNG or JPG."""
    if data.startswith(b"\x89PNG"):
        return b"IEND" in data[-64:]
    if data.startswith(b"\xff\xd8"):
        return data.rfind(b"\xff\xd9") > data.rfind(b"\xff\xda")  # end of image after the last start of scan
    return len(data) > 0


def encode_metres(values: np.ndarray, units_per_m: float) -> np.ndarray:
    """(H, W) metres -> (H, W) uint16, rounded; what does not fit becomes the largest value."""
    units: np.ndarray = np.clip(np.nan_to_num(values) * units_per_m + 0.5, 0, 65535).astype(np.uint16)
    return units
