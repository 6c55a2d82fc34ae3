"""A recording whose frames are image files: what every reader builds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..recon.core.camera import Camera
from ..recon.core.depth_image import DEPTH_SUFFIXES
from ..recon.core.errors import DataError, FrameError
from ..recon.core.frame import Frame
from ..recon.core.pose import NO_POSE, Pose
from .calibration import Calibration
from .depth_units import sensor_units
from .images import IMAGE_SUFFIXES, Undistorter, read_color, read_depth
from .intrinsics import fit_calibration
from .names import match_names, sorted_names
from .pose_files import FramePoses
from .poses import pose_notes
from .registration import ColorRegistration


@dataclass(frozen=True)
class Entry:
    """The files of one frame. A sensor that is missing from `depths` has no measurement in this frame."""

    color: Path
    depths: dict[str, Path]
    pose: Pose = NO_POSE
    timestamp: float | None = None


def frame_entries(
    colors: Mapping[str, Path],
    sensors: Mapping[str, Mapping[str, Path]],
    poses: FramePoses,
    stamps: np.ndarray | None = None,
) -> list[Entry]:
    """A frame for each colour image, with the depth images of all sensors that have its name or number.

    `colors` and the files of each sensor are by file stem; `poses` and `stamps` (N,) are in the order of `colors`.
    """
    stems = list(colors)
    depths = {sensor: match_names(stems, files) for sensor, files in sensors.items()}
    return [
        Entry(
            colors[stem],
            {sensor: files[stem] for sensor, files in depths.items() if stem in files},
            poses.poses[index],
            None if stamps is None else float(stamps[index]),
        )
        for index, stem in enumerate(stems)
    ]


class FileRecording:
    """Implements `recon.frame.Recording`. Raises DataError where the entries make no recording.

    Colour of a camera of its own (`calibration.color_camera`) is registered to the depth images.
    """

    def __init__(
        self,
        root: Path,
        format: str,
        entries: Sequence[Entry],
        sensors: Sequence[str],
        calibration: Calibration,
        *,
        name: str | None = None,
        notes: Sequence[str] = (),
        reference_mesh: Path | None = None,
    ) -> None:
        if not entries:
            raise DataError(f"{root} holds no frames that can be read as `{format}`")
        if not sensors:
            raise DataError(f"{root} holds colour but no depth images that can be read as `{format}`")
        self.root, self.format = root, format
        self.name = name or root.resolve().name
        self.sensors = tuple(sensors)
        self.reference_mesh = reference_mesh
        self.has_timestamps = all(entry.timestamp is not None for entry in entries)
        self.has_poses = any(entry.pose.T_world_camera is not None for entry in entries)
        self._entries = tuple(entries)
        depths = [path for entry in entries for path in entry.depths.values()]
        calibration, camera_notes = fit_calibration(calibration, depths, [entry.color for entry in entries])
        self._calibration = calibration
        self._undistorter = self._color_undistorter = Undistorter(
            calibration.camera, calibration.distortion, calibration.is_fisheye
        )
        self._registration: ColorRegistration | None = None
        if calibration.color_camera is not None and calibration.T_color_depth is not None:
            self._color_undistorter = Undistorter(
                calibration.color_camera, calibration.color_distortion, calibration.color_is_fisheye
            )
            self._registration = ColorRegistration(
                calibration.color_camera, calibration.T_color_depth, calibration.camera
            )
        self._require_increasing_timestamps()
        files = {sensor: [e.depths[sensor] for e in entries if sensor in e.depths] for sensor in sensors}
        self._depth_units, unit_notes = sensor_units(files, calibration.depth_units_per_m)
        self.notes = (
            *notes,
            *camera_notes,
            *unit_notes,
            *self._sensor_notes(),
            *unused_images(self._entries),
            *pose_notes([entry.pose for entry in entries]),
        )

    @property
    def camera(self) -> Camera:
        """The camera of the frames: undistorted, without the margin."""
        return self._calibration.camera.cropped(self._calibration.margin_px)

    @property
    def registration_sigma_px(self) -> float:
        """How far colour may lie beside the depth it belongs to, by an error that all frames share; pixels."""
        return self._calibration.registration_sigma_px

    def __len__(self) -> int:
        return len(self._entries)

    def __getitem__(self, index: int) -> Frame:
        entry = self._entries[index]
        index %= len(self)
        depths = {sensor: self.depth(index, sensor) for sensor in self.sensors}
        return Frame(index, self.timestamp(index), self.color(index), depths, entry.pose.T_world_camera)

    def timestamp(self, index: int) -> float:
        """Seconds, or the index where the recording has no clock."""
        stamp = self._entries[index].timestamp
        return float(index) if stamp is None or not self.has_timestamps else stamp

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera or None."""
        return self._entries[index].pose.T_world_camera

    def color(self, index: int) -> Tensor:
        """(H, W, 3) uint8 RGB. Raises FrameError."""
        camera = self._calibration.color_camera or self._calibration.camera
        try:
            image = read_color(
                self._entries[index].color, camera, self._calibration.resize_color and self._registration is None
            )
        except DataError as error:
            raise FrameError(f"frame {index}: {error}") from error
        image = self._color_undistorter.color(image)
        if self._registration is not None:
            image = self._registration(image, self._depth_to_register_by(index))
        return self._cropped(image)

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement; all zero where the sensor has no image. Raises FrameError."""
        path = self._entries[index].depths.get(sensor)
        if path is None:
            return torch.zeros(self.camera.height, self.camera.width)
        try:
            return self._cropped(self._read_depth(path, sensor))
        except DataError as error:
            raise FrameError(f"frame {index}: {error}") from error

    def _read_depth(self, path: Path, sensor: str) -> np.ndarray:
        image = read_depth(path, self._calibration.camera, self._depth_units[sensor])
        return self._undistorter.depth(image)

    def _depth_to_register_by(self, index: int) -> np.ndarray:
        """(H, W) metres of the first sensor with an image that can be read, all zero if there is none."""
        depths = self._entries[index].depths
        for sensor in self.sensors:
            with suppress(DataError):  # a bad depth image costs no more than itself
                if sensor in depths:
                    return self._read_depth(depths[sensor], sensor)
        return np.zeros((self._calibration.camera.height, self._calibration.camera.width), np.float32)

    def _cropped(self, image: np.ndarray) -> Tensor:
        height, width = image.shape[:2]
        margin = self._calibration.margin_px
        inner = image[margin : height - margin, margin : width - margin]
        return torch.from_numpy(np.ascontiguousarray(inner))

    def _require_increasing_timestamps(self) -> None:
        stamps = np.array([self.timestamp(index) for index in range(len(self))])
        steps = np.diff(stamps)
        if not np.isfinite(stamps).all() or (steps <= 0).any():
            bad = int(np.argmin(np.isfinite(steps) & (steps > 0))) + 1 if len(steps) else 0
            raise DataError(
                f"{self.root}: time stamps must increase, but frame {bad} does not come after the one before"
            )

    def _sensor_notes(self) -> list[str]:
        counts = {sensor: sum(sensor in entry.depths for entry in self._entries) for sensor in self.sensors}
        return [
            f"sensor {sensor} has no image in {len(self) - count} of {len(self)} frames"
            for sensor, count in counts.items()
            if count < len(self)
        ]


def unused_images(entries: Sequence[Entry]) -> list[str]:
    """A line for each folder with image files that belong to no frame: how many, the first, and why."""
    used = {path for entry in entries for path in (entry.color, *entry.depths.values())}
    notes = []
    for folder in dict.fromkeys(path.parent for entry in entries for path in (entry.color, *entry.depths.values())):
        if not folder.is_dir():
            continue
        names = {
            path.name: path for path in folder.iterdir() if path.suffix.lower() in (*IMAGE_SUFFIXES, *DEPTH_SUFFIXES)
        }
        unused = [names[name] for name in sorted_names(names) if names[name] not in used and name[0] != "."]
        stems = {path.stem for path in used if path.parent == folder}
        twins = [path for path in unused if path.stem in stems]
        others = [path for path in unused if path.stem not in stems]
        if twins:
            notes.append(
                f"{folder} holds {len(twins)} images beside another of the same name, not used: {twins[0].name}"
            )
        if others:
            notes.append(f"{len(others)} images of {folder} belong to no frame (the first: {others[0].name})")
    return notes
