"""The calibration that the files of a recording state, in the layouts that tools write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from ..recon.core.text import parse_number, read_table, read_text, text_lines
from .calibration import CAMERA_FILE, MAX_DEPTH_SCALE, MIN_DEPTH_SCALE, Calibration, CameraFile, intrinsics_of_matrix
from .images import usual_size

# Text files of a matrix, or of `fx fy cx cy` and distortion (ETH3D), by name.
TEXT_FILES = (
    "camera-intrinsics.txt",
    "camera_intrinsics.txt",
    "camera-intrinsic.txt",
    "camera_intrinsic.txt",
    "intrinsics.txt",
    "intrinsic.txt",
    "calibration.txt",
)
INFO_FILE = "info.txt"  # BundleFusion, 12-Scenes
JSON_FILES, MATRIX_FIELD = ("*intrinsic*.json", "*cam*.json"), '"intrinsic_matrix"'  # Open3D
_EXPECTED = "a 3x3 intrinsic matrix, or `fx fy cx cy` with k1 k2 p1 p2 and k3 or without"


def find_camera_file(folders: Sequence[Path]) -> Path | None:
    """The first of `folders` with a file of the camera, and that file. Raises DataError if it has several."""
    for folder in folders:
        for name in (CAMERA_FILE, *TEXT_FILES):
            if (folder / name).is_file():
                return folder / name
        if (folder / INFO_FILE).is_file() and "m_calibration" in read_text(folder / INFO_FILE):
            return folder / INFO_FILE
        candidates = {path for pattern in JSON_FILES for path in folder.glob(pattern) if path.is_file()}
        found = sorted(path for path in candidates if MATRIX_FIELD in read_text(path))
        if len(found) > 1:
            names = ", ".join(path.name for path in found)
            raise DataError(
                f"{folder} holds several camera files ({names}); copy that of the depth images to {CAMERA_FILE}"
            )
        if found:
            return found[0]
    return None


def calibration_or(
    folders: Path | Sequence[Path], default: Calibration, depths: Sequence[Path]
) -> tuple[Calibration, tuple[str, ...]]:
    """`default`, unless one of `folders` holds a file of the camera; and the note that says so.

    `depths` are the depth images, for the size of the image where the file does not state it. Raises DataError.
    """
    folders = [folders] if isinstance(folders, Path) else folders
    path = find_camera_file(folders)
    if path is None:
        return default, ()
    return read_camera_file(path, default, depths), (f"intrinsics are those of {path.name}",)


def read_camera_file(path: Path, default: Calibration, depths: Sequence[Path]) -> Calibration:
    """The calibration of a file that `find_camera_file` found; `default` has its depth scale. Raises DataError."""
    if path.suffix.lower() == ".json":
        return CameraFile.load(path).calibration(default.depth_units_per_m)
    if path.name == INFO_FILE:
        return _info_calibration(path, default)
    size = usual_size(depths, default.camera)
    table = read_table(path, _is_camera, _EXPECTED)
    values = np.concatenate([np.array(row) for row in table.rows])
    try:
        if values.size in (4, 8) or (values.size == 9 and len(table.rows) == 1 and values[1] != 0):
            fields, distortion = dict(zip(("fx", "fy", "cx", "cy"), values[:4], strict=True)), tuple(values[4:])
        else:
            fields, distortion = intrinsics_of_matrix(values), ()
    except ValueError as error:
        raise DataError(f"{path}: {error}") from error
    if not np.isfinite(values).all() or min(fields["fx"], fields["fy"]) <= 0:
        raise DataError(f"{path}: fx and fy must be positive, found {fields['fx']:g} and {fields['fy']:g}")
    return Calibration(camera_of(size, fields), default.depth_units_per_m, distortion)


def camera_of(size: tuple[int, int], fields: Mapping[str, float]) -> Camera:
    """The camera of images of `size` (width, height) with fx, fy, cx, cy in `fields`."""
    fx, fy, cx, cy = (float(fields[name]) for name in ("fx", "fy", "cx", "cy"))
    return Camera(*size, fx, fy, cx, cy)


def _is_camera(widths: Sequence[int]) -> bool:
    return tuple(widths) in {(3, 3, 3), (4,) * 4, (4,) * 3, (9,), (4,), (8,), (12,), (16,)}


def _info_calibration(path: Path, default: Calibration) -> Calibration:
    """Of `info.txt`: lines `name = value`, matrices of 4x4 row by row. Raises DataError."""
    pairs = (line.text.partition("=") for line in text_lines(path))
    entries = {key.strip(): value for key, _, value in pairs}
    cameras = []
    for name in ("Depth", "Color"):
        width, height = (_info_numbers(path, entries, f"m_{name.lower()}{side}", 1)[0] for side in ("Width", "Height"))
        matrix = _info_numbers(path, entries, f"m_calibration{name}Intrinsic", 16)
        extrinsic = f"m_calibration{name}Extrinsic"
        if extrinsic in entries and not np.allclose(_info_numbers(path, entries, extrinsic, 16), np.eye(4).ravel()):
            raise DataError(f"{path}: {extrinsic} moves the camera; state color_camera, T_color_depth in {CAMERA_FILE}")
        try:
            cameras.append(camera_of((int(width), int(height)), intrinsics_of_matrix(matrix)))
        except ValueError as error:
            raise DataError(f"{path}, {name}: {error}") from error
    depth, color = cameras
    stated_units = "m_depthShift" in entries
    units = float(_info_numbers(path, entries, "m_depthShift", 1)[0]) if stated_units else default.depth_units_per_m
    if not MIN_DEPTH_SCALE <= units <= MAX_DEPTH_SCALE:
        raise DataError(f"{path}: m_depthShift = {units:g} is no number of depth units in a metre (often 1000)")
    if color == depth:
        return Calibration(depth, units)
    return Calibration(depth, units, color_camera=color, T_color_depth=np.eye(4))


def _info_numbers(path: Path, entries: dict[str, str], name: str, count: int) -> np.ndarray:
    values = [parse_number(word) for word in entries.get(name, "").split()]
    numbers = [value for value in values if value is not None and np.isfinite(value)]
    if len(numbers) != count or len(values) != count:
        raise DataError(f"{path}: expected {name} = {count} numbers; a {CAMERA_FILE} can state the camera instead")
    return np.array(numbers)
