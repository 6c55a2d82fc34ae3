"""Own recordings: `camera.json`, `color/`, any number of depth folders, optional poses (docs/data-formats.md)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from ..recon.core.mesh_files.reader import READABLE_SUFFIXES
from ..recon.core.text import read_table
from ..recon.core.time_stamps import SECONDS, unit_of
from .calibration import CAMERA_FILE, Calibration, CameraFile
from .camera_files import find_camera_file, read_camera_file
from .images import list_depth_files, list_files, read_size
from .layout import ASSOCIATION_FILES, first_file
from .names import match_names, numbers_of_names
from .pose_files import FramePoses, poses_of_files, poses_of_table
from .recording import FileRecording, frame_entries

TIMESTAMPS_FILE = "timestamps.txt"
COLOR_FOLDERS = ("color", "rgb", "colour", "images")
POSE_TABLES = tuple(
    f"{stem}{suffix}"
    for stem in ("poses", "trajectory", "traj", "groundtruth")
    for suffix in (".txt", ".csv", ".tum", ".log", ".kitti", ".g2o")
)
POSE_FOLDERS = ("poses", "pose")
OTHER_LAYOUTS = (*ASSOCIATION_FILES, "rgb.txt", "depth.txt", "intrinsic", "frames")


def matches(path: Path) -> bool:
    """Whether the folder has colour and depth folders, and a file of the camera or nothing of another layout."""
    if (path / CAMERA_FILE).is_file() and (path / "color").is_dir():
        return True
    if _color_folder(path) is None or any((path / name).exists() for name in OTHER_LAYOUTS):
        return False
    has_depth = any(folder.is_dir() for folder in path.glob("depth*"))
    return has_depth and (find_camera_file([path]) is not None or not (path / "pose").is_dir())


def read(path: Path) -> FileRecording:
    """Open a recording. Raises DataError."""
    folder = _color_folder(path)
    colors = list_files(folder) if folder else {}
    if not colors:
        raise DataError(f"{folder or path / 'color'} holds no PNG or JPG images")
    stems = list(colors)
    sensors = _read_sensors(path, stems)
    camera_file = find_camera_file([path])
    if camera_file is None:
        raise DataError(_camera_request(path, next(iter(next(iter(sensors.values()), colors).values()))))
    depths = [file for files in sensors.values() for file in files.values()]
    calibration = read_camera_file(camera_file, Calibration(Camera(1, 1, 1, 1, 0, 0)), depths)
    notes: tuple[str, ...] = ()
    stamps_file = None
    if camera_file.suffix.lower() == ".json":
        stamps_file = CameraFile.load(camera_file).timestamps
    if camera_file.name != CAMERA_FILE:
        units = f"{calibration.depth_units_per_m:g} depth units a metre"
        notes = (f"intrinsics are those of {camera_file.name}, with {units}; a {CAMERA_FILE} states others",)
    stamps, stamp_notes = _read_timestamps(path, stamps_file, stems)
    poses = _read_poses(path, stems, stamps)
    return FileRecording(
        path,
        "folder",
        frame_entries(colors, sensors, poses, stamps),
        tuple(sensors),
        calibration,
        notes=(*notes, *stamp_notes, *poses.notes),
        reference_mesh=first_file(path / f"mesh_gt{suffix}" for suffix in READABLE_SUFFIXES),
    )


def _color_folder(path: Path) -> Path | None:
    return next((path / name for name in COLOR_FOLDERS if (path / name).is_dir()), None)


def _camera_request(path: Path, image: Path) -> str:
    """What to write where no file states the camera."""
    width, height = read_size(image)
    fields = f'"width": {width}, "height": {height}, "fx": ?, "fy": ?, "cx": ?, "cy": ?, "depth_scale": ?'
    return (
        f"{path} holds no {CAMERA_FILE}; write one and fill in the intrinsics of the depth images in pixels and the "
        f"value of a depth pixel at one metre (1000 for millimetres): {{{fields}}} (docs/data-formats.md)"
    )


def _read_sensors(path: Path, stems: Sequence[str]) -> dict[str, dict[str, Path]]:
    """Sensor name -> file stem -> depth image, of `depth/` and of every `depth_<sensor>/`."""
    folders = sorted(folder for folder in path.iterdir() if folder.is_dir())
    named = {folder.name.removeprefix("depth_"): folder for folder in folders if folder.name.startswith("depth_")}
    if (path / "depth").is_dir():
        named = {"depth": path / "depth", **named}
    sensors = {name: list_depth_files(folder) for name, folder in named.items() if name}
    for name, files in sensors.items():
        if files and not match_names(stems, files):
            raise DataError(
                f"{named[name]}: no depth image has the name or number of a colour image "
                f"({next(iter(files.values())).name}, but {stems[0]} is the first of colour); the images of a frame "
                "need the same; images named by different time stamps need the lists of the format tum"
            )
    return {name: files for name, files in sensors.items() if files}


def _read_timestamps(path: Path, name: str | None, stems: Sequence[str]) -> tuple[np.ndarray | None, tuple[str, ...]]:
    """(N,) seconds of the colour images and notes; None if the recording has no clock.

    A line holds a time stamp, or the name or number of an image and its time stamp.
    """
    file = path / (name or TIMESTAMPS_FILE)
    if name is None and not file.is_file():
        return None, ()
    table = read_table(file, lambda widths: set(widths) in ({1}, {2}), "time stamps, one line for each colour image")
    values = np.array(table.rows)
    if len(values) != len(stems) and not table.names and values.shape[1] == 1:
        raise DataError(f"{file} holds {len(values)} time stamps for {len(stems)} colour images; one line for each")
    stamps = _of_images(file, table.names, values, stems)
    if not np.isfinite(stamps).all():
        raise DataError(f"{file}: time stamps must be finite, but that of {stems[int(np.argmin(stamps))]} is not")
    unit = unit_of(stamps)
    notes = (f"time stamps of {file.name} are read as {unit.name}",) if unit != SECONDS else ()
    return stamps * unit.seconds, notes


def _of_images(file: Path, names: Sequence[str], values: np.ndarray, stems: Sequence[str]) -> np.ndarray:
    """(N,) time stamps of the images `stems`, as in the file. Raises DataError."""
    stamps = values[:, -1]
    if names:
        labelled = {Path(name.replace("\\", "/")).stem: stamp for name, stamp in zip(names, stamps, strict=True)}
        by_name = match_names(stems, labelled)
    elif values.shape[1] == 2:
        numbers = numbers_of_names(stems) or [float(index) for index in range(len(stems))]
        numbered = dict(zip(values[:, 0].tolist(), stamps, strict=True))
        if not set(numbers) & set(numbered):
            numbers = [float(index) for index in range(len(stems))]
        by_name = {stem: numbered[n] for stem, n in zip(stems, numbers, strict=True) if n in numbered}
    else:
        return stamps
    missing = [stem for stem in stems if stem not in by_name]
    if missing:
        raise DataError(
            f"{file}: {len(missing)} of {len(stems)} colour images have no time stamps (first: {missing[0]})"
        )
    return np.array([by_name[stem] for stem in stems])


def _read_poses(path: Path, stems: Sequence[str], stamps: np.ndarray | None) -> FramePoses:
    """T_world_camera of each frame, OpenCV axes: from a file of all poses, else from a folder with a file for each."""
    files = [path / name for name in POSE_TABLES if (path / name).is_file()]
    if files:
        found = poses_of_table(files[0], stems, stamps)
        others = ", ".join(file.name for file in files[1:])
        note = (f"poses are those of {files[0].name}; {others} is not read",) if others else ()
        return FramePoses(found.poses, (*note, *found.notes))
    folders = [path / name for name in POSE_FOLDERS]
    return poses_of_files(next((folder for folder in folders if folder.is_dir()), folders[0]), stems)
