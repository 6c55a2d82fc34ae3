"""SenFuNet-Replica: rendered rooms with several depth sensors; units and axes: docs/uncle-paper.md, Data sets."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from .calibration import Calibration
from .camera_files import calibration_or
from .images import list_depth_files, list_files, read_size
from .layout import choose_sequence, first_file
from .pose_files import poses_of_files
from .poses import OPENGL_TO_OPENCV, Z_UP_FROM_Y_UP
from .recording import FileRecording, frame_entries

# The sensors of the data set by their folder; any other depth folder becomes a sensor of its own name.
SENSOR_OF_FOLDER = {
    "left_depth_gt": "gt",
    "left_depth_noise_1.0": "sl",
    "left_depth_noise_5.0": "tof",
    "left_sgm_depth": "sgm",
    "left_psmnet_depth": "psmnet",
}


def matches(path: Path) -> bool:
    """Whether the folder has `left_rgb`, of the folder or of a trajectory in it."""
    return (path / "left_rgb").is_dir() or any(path.glob("*/left_rgb"))


def read(path: Path) -> FileRecording:
    """Open a scene (its first trajectory) or one trajectory of it. Raises DataError."""
    trajectory, notes = choose_sequence(path, "left_rgb")
    colors = list_files(trajectory / "left_rgb")
    if not colors:
        raise DataError(f"{trajectory / 'left_rgb'} holds no PNG or JPG images")
    width, height = read_size(next(iter(colors.values())))
    # Rendered with a horizontal field of view of 90 degrees about the middle of the image. The middle is width / 2
    # counted from the outer edge of the first pixel, hence (width - 1) / 2 from its centre, which is our origin.
    default = Calibration(Camera(width, height, width / 2, width / 2, (width - 1) / 2, (height - 1) / 2))
    sensors = {sensor: list_depth_files(folder) for sensor, folder in _depth_folders(trajectory).items()}
    depths = [file for files in sensors.values() for file in files.values()]
    calibration, camera_notes = calibration_or(trajectory, default, depths)
    poses = poses_of_files(trajectory / "left_camera_matrix", list(colors), _to_opencv)
    entries = frame_entries(colors, sensors, poses)
    names = ("mesh_gt.ply", "gt_mesh.ply", "mesh.ply")
    scene = trajectory.resolve().parent
    mesh = first_file([folder / name for folder in (trajectory, scene) for name in names])
    return FileRecording(
        trajectory,
        "senfunet",
        entries,
        tuple(sensors),
        calibration,
        name=f"{scene.name}-{trajectory.resolve().name}",
        notes=notes + camera_notes + poses.notes,
        reference_mesh=mesh,
    )


def _to_opencv(matrix: np.ndarray) -> np.ndarray:
    return Z_UP_FROM_Y_UP @ matrix @ OPENGL_TO_OPENCV


def _depth_folders(trajectory: Path) -> dict[str, Path]:
    """Sensor -> folder: known ones in the order of the table above, then others by name of folder.

    Folders without images are no sensors.
    """
    folders = {folder.name: folder for folder in trajectory.iterdir() if folder.is_dir()}
    ordered = [name for name in SENSOR_OF_FOLDER if name in folders]
    ordered += sorted(folders.keys() - set(ordered))
    sensors: dict[str, Path] = {}
    for name in ordered:
        sensor = _sensor_name(name)
        if sensor and list_files(folders[name]):
            sensors[sensor] = folders[name]
    return sensors


def _sensor_name(folder: str) -> str | None:
    match = re.fullmatch(r"left_(.+)_depth|left_depth_(.+)", folder)
    return SENSOR_OF_FOLDER.get(folder) or (match and (match[1] or match[2]))
