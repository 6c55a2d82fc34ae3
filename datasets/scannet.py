"""ScanNet: a structured-light sensor on a tablet, as images; units and axes: docs/uncle-paper.md, Data sets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from .calibration import CAMERA_FILE, Calibration, calibration_or
from .images import list_depth_files, list_files, read_size
from .layout import first_file
from .poses import checked_pose, read_matrix
from .recording import Entry, FileRecording

TYPICAL = Camera(640, 480, 577.59, 578.73, 318.91, 242.68)
BORDER_PX = 10  # the export leaves a black rim around the colour images


def matches(path: Path) -> bool:
    """Whether the folder has `color` beside `pose` or `intrinsic`."""
    base = _base(path)
    return (base / "color").is_dir() and ((base / "pose").is_dir() or (base / "intrinsic").is_dir())


def read(path: Path) -> FileRecording:
    """Open a scene. Raises DataError."""
    base = _base(path)
    colors, depths = list_files(base / "color"), list_depth_files(base / "depth")
    if not colors or not depths:
        raise DataError(f"{base} holds no {'depth' if colors else 'color'}/ images; scannet needs color/ and depth/")
    calibration, notes = _calibration(path, base, next(iter(depths.values())))
    poses = list_files(base / "pose", (".txt",))
    entries = [
        Entry(
            color,
            {"depth": depths[stem]} if stem in depths else {},
            checked_pose(read_matrix(poses.get(stem))),  # OpenCV axes; a lost camera is written as -inf
        )
        for stem, color in colors.items()
    ]
    scene = path.resolve().name
    meshes = ["mesh_gt.ply", f"{scene}_vh_clean.ply", f"{scene}_vh_clean_2.ply"]
    return FileRecording(
        path,
        "scannet",
        entries,
        ("depth",),
        replace(calibration, resize_color=True, margin_px=BORDER_PX),
        notes=(*notes, f"a rim of {BORDER_PX} pixels is cut off"),
        reference_mesh=first_file([path / name for name in meshes]),
    )


def _base(path: Path) -> Path:
    return path / "frames" if (path / "frames").is_dir() else path


def _calibration(path: Path, base: Path, first_depth: Path) -> tuple[Calibration, tuple[str, ...]]:
    """From camera.json, else the export's depth intrinsics, else those of a typical scene."""
    width, height = read_size(first_depth)
    file = first_file([base / "intrinsic" / "intrinsic_depth.txt", path / "intrinsic" / "intrinsic_depth.txt"])
    if file is None:
        typical = Calibration(TYPICAL.resized(width, height))
        assumed = (f"no intrinsic/intrinsic_depth.txt: typical intrinsics are used; a {CAMERA_FILE} states others",)
        calibration, notes = calibration_or(path, typical)
        return calibration, notes or assumed
    matrix = read_matrix(file)
    if matrix is None or not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
        raise DataError(f"{file} holds no 4x4 intrinsic matrix")
    fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return calibration_or(path, Calibration(Camera(width, height, fx, fy, cx, cy)))
