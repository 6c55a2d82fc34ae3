"""Own recordings: `camera.json`, `color/`, any number of depth folders, optional poses (docs/data-formats.md)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..recon.core.errors import DataError
from .calibration import CAMERA_FILE, CameraFile
from .images import list_depth_files, list_files
from .layout import first_file
from .poses import MAX_POSE_GAP_S, checked_pose, poses_at, read_matrix
from .recording import Entry, FileRecording

TIMESTAMPS_FILE = "timestamps.txt"


def matches(path: Path) -> bool:
    """Whether the folder has a `camera.json` and the folder `color`."""
    return (path / CAMERA_FILE).is_file() and (path / "color").is_dir()


def read(path: Path) -> FileRecording:
    """Open a recording. Raises DataError."""
    camera_file = CameraFile.load(path)
    if camera_file is None:
        raise DataError(f"{path} holds no {CAMERA_FILE}; docs/data-formats.md has one to copy")
    colors = list_files(path / "color")
    if not colors:
        raise DataError(f"{path / 'color'} holds no PNG or JPG images")
    stems = list(colors)
    sensors = _read_sensors(path, stems)
    stamps = _read_timestamps(path, camera_file.timestamps, stems)
    poses = _read_poses(path, stems, stamps)
    entries = [
        Entry(
            colors[stem],
            {sensor: files[stem] for sensor, files in sensors.items() if stem in files},
            poses[index],
            None if stamps is None else float(stamps[index]),
        )
        for index, stem in enumerate(stems)
    ]
    mesh = first_file([path / "mesh_gt.ply"])
    return FileRecording(path, "folder", entries, tuple(sensors), camera_file.calibration(), reference_mesh=mesh)


def _read_sensors(path: Path, stems: list[str]) -> dict[str, dict[str, Path]]:
    """Sensor name -> file stem -> depth image, of `depth/` and of every `depth_<sensor>/`."""
    folders = sorted(folder for folder in path.iterdir() if folder.is_dir())
    named = {folder.name.removeprefix("depth_"): folder for folder in folders if folder.name.startswith("depth_")}
    if (path / "depth").is_dir():
        named = {"depth": path / "depth", **named}
    sensors = {name: list_depth_files(folder) for name, folder in named.items() if name}
    for name, files in sensors.items():
        if files and not any(stem in files for stem in stems):
            raise DataError(
                f"{named[name]}: no depth image is called like a colour image ({next(iter(files.values())).name}, but "
                f"{stems[0]} in color/); the two images of a frame need the same name"
            )
    return {name: files for name, files in sensors.items() if files}


def _read_timestamps(path: Path, name: str | None, stems: list[str]) -> np.ndarray | None:
    """(N,) seconds, a line per colour image in order; None if the recording has no clock."""
    file = path / (name or TIMESTAMPS_FILE)
    if name is None and not file.is_file():
        return None
    try:
        lines = [line.split() for line in file.read_text().splitlines()]
        stamps = np.array([float(words[-1]) for words in lines if words and words[0][0] != "#"])
    except (OSError, ValueError) as error:
        raise DataError(f"cannot read the time stamps in {file}: {error}") from error
    if len(stamps) != len(stems):
        raise DataError(f"{file} holds {len(stamps)} time stamps for {len(stems)} colour images; one line for each")
    return stamps


def _read_poses(path: Path, stems: list[str], stamps: np.ndarray | None) -> list[np.ndarray | None]:
    """T_world_camera of each frame, OpenCV axes: from `poses.txt`, else from `poses/<name>.txt`."""
    if (path / "poses.txt").is_file():
        if stamps is None:  # the first column counts frames from 0, and there is nothing between two frames
            return poses_at(path / "poses.txt", np.arange(len(stems), dtype=float), max_gap_s=0.0)
        return poses_at(path / "poses.txt", stamps, MAX_POSE_GAP_S)
    files = list_files(path / "poses", (".txt",))
    if files and not any(stem in files for stem in stems):
        raise DataError(f"{path / 'poses'}: no pose file is called like a colour image ({stems[0]}.txt, for example)")
    return [checked_pose(read_matrix(files.get(stem))) for stem in stems]
