"""Replica as rendered for NICE-SLAM; units, camera and axes: docs/uncle-paper.md, Data sets."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..recon.core.camera import Camera
from ..recon.core.depth_image import DEPTH_SUFFIXES
from ..recon.core.errors import DataError
from .calibration import Calibration, calibration_or
from .images import list_numbered
from .layout import first_file
from .poses import checked_pose, matrix_from_text
from .recording import Entry, FileRecording

RENDERED = Calibration(Camera(1200, 680, 600.0, 600.0, 599.5, 339.5), 6553.5)


def matches(path: Path) -> bool:
    """Whether the folder has `results/frame*`."""
    return any((path / "results").glob("frame*"))


def read(path: Path) -> FileRecording:
    """Open a scene. Raises DataError."""
    calibration, notes = calibration_or(path, RENDERED)
    colors = list_numbered(path / "results", "frame")
    depths = list_numbered(path / "results", "depth", DEPTH_SUFFIXES)
    poses = _read_trajectory(path / "traj.txt")
    entries = [
        Entry(
            color,
            {"depth": depths[number]} if number in depths else {},
            poses[number] if number < len(poses) else None,
        )
        for number, color in colors.items()
    ]
    mesh = first_file([path / "mesh_gt.ply", path.resolve().parent / f"{path.resolve().name}_mesh.ply"])
    sensors = ("depth",) if depths else ()
    return FileRecording(path, "replica", entries, sensors, calibration, notes=notes, reference_mesh=mesh)


def _read_trajectory(path: Path) -> list[np.ndarray | None]:
    """One camera-to-world matrix a line, OpenCV axes; line i belongs to frame i."""
    if not path.is_file():
        return []
    try:
        return [checked_pose(matrix_from_text(line)) for line in path.read_text().splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
