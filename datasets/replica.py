"""Replica as rendered for NICE-SLAM; units, camera and axes: docs/uncle-paper.md, Data sets."""

from __future__ import annotations

from pathlib import Path

from ..recon.core.camera import Camera
from ..recon.core.depth_image import DEPTH_SUFFIXES
from ..recon.core.pose import NO_POSE
from .calibration import Calibration
from .camera_files import calibration_or
from .images import list_numbered
from .layout import first_file
from .pose_files import FramePoses, poses_of_table
from .recording import FileRecording, frame_entries

RENDERED = Calibration(Camera(1200, 680, 600.0, 600.0, 599.5, 339.5), 6553.5)


def matches(path: Path) -> bool:
    """Whether the folder has `results/frame*`."""
    return any((path / "results").glob("frame*"))


def read(path: Path) -> FileRecording:
    """Open a scene. Raises DataError."""
    colors = _by_number(list_numbered(path / "results", "frame"))
    depths = _by_number(list_numbered(path / "results", "depth", DEPTH_SUFFIXES))
    calibration, notes = calibration_or(path, RENDERED, list(depths.values()))
    poses = FramePoses([NO_POSE] * len(colors))
    if colors and (path / "traj.txt").is_file():
        poses = poses_of_table(path / "traj.txt", list(colors), None)  # camera to world, OpenCV axes
    entries = frame_entries(colors, {"depth": depths}, poses)
    mesh = first_file([path / "mesh_gt.ply", path.resolve().parent / f"{path.resolve().name}_mesh.ply"])
    sensors = ("depth",) if depths else ()
    return FileRecording(path, "replica", entries, sensors, calibration, notes=notes + poses.notes, reference_mesh=mesh)


def _by_number(files: dict[int, Path]) -> dict[str, Path]:
    return {str(number): path for number, path in files.items()}
