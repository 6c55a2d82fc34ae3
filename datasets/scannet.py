"""ScanNet: a structured-light sensor on a tablet, as images; units and axes: docs/uncle-paper.md, Data sets."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from .calibration import CAMERA_FILE, Calibration
from .camera_files import calibration_or, read_camera_file
from .images import list_depth_files, list_files, read_size
from .layout import first_file
from .pose_files import poses_of_files
from .recording import FileRecording, frame_entries

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
    poses = poses_of_files(base / "pose", list(colors))  # OpenCV axes; a lost camera is written as -inf
    entries = frame_entries(colors, {"depth": depths}, poses)
    scene = path.resolve().name
    meshes = ["mesh_gt.ply", f"{scene}_vh_clean.ply", f"{scene}_vh_clean_2.ply"]
    return FileRecording(
        path,
        "scannet",
        entries,
        ("depth",),
        replace(calibration, resize_color=True, margin_px=BORDER_PX),
        notes=(*notes, *poses.notes, f"a rim of {BORDER_PX} pixels is cut off"),
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
        calibration, notes = calibration_or(path, typical, [first_depth])
        return calibration, notes or assumed
    stated = Calibration(Camera(width, height, 1.0, 1.0, 0.0, 0.0))
    return calibration_or(path, read_camera_file(file, stated, [first_depth]), [first_depth])
