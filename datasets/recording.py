"""A recording whose frames are image files: what every reader builds."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError, FrameError
from ..recon.core.frame import Frame
from .calibration import Calibration
from .depth_units import sensor_units
from .images import Undistorter, read_color, read_depth
from .poses import pose_notes
from .registration import ColorRegistration


@dataclass(frozen=True)
class Entry:
    """The files of one frame. A sensor that is missing from `depths` has no measurement in this frame."""

    color: Path
    depths: dict[str, Path]
    T_world_camera: np.ndarray | None = None
    timestamp: float | None = None


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
        self.has_poses = any(entry.T_world_camera is not None for entry in entries)
        self._entries = tuple(entries)
        self._calibration = calibration
        self._undistorter = self._color_undistorter = Undistorter(calibration.camera, calibration.distortion)
        self._registration: ColorRegistration | None = None
        if calibration.color_camera is not None and calibration.T_color_depth is not None:
            self._color_undistorter = Undistorter(calibration.color_camera, calibration.color_distortion)
            self._registration = ColorRegistration(
                calibration.color_camera, calibration.T_color_depth, calibration.camera
            )
        self._require_increasing_timestamps()
        files = {sensor: [e.depths[sensor] for e in entries if sensor in e.depths] for sensor in sensors}
        self._depth_units, unit_notes = sensor_units(files, calibration.depth_units_per_m)
        self.notes = (
            *notes,
            *unit_notes,
            *self._sensor_notes(),
            *pose_notes([entry.T_world_camera for entry in entries]),
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
        return Frame(index, self.timestamp(index), self.color(index), depths, entry.T_world_camera)

    def timestamp(self, index: int) -> float:
        """Seconds, or the index where the recording has no clock."""
        stamp = self._entries[index].timestamp
        return float(index) if stamp is None or not self.has_timestamps else stamp

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera or None."""
        return self._entries[index].T_world_camera

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
