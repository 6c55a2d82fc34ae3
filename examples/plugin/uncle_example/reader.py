"""A reader for folders with `camera.json` and a file `frame_*.npz` for each frame.

camera.json     {"width": 640, "height": 480, "fx": 525, "fy": 525, "cx": 319.5, "cy": 239.5}
frame_*.npz     color (H, W, 3) uint8 RGB; depth_<sensor> (H, W) metres, 0 = no measurement, for each sensor; optionally
                pose (4, 4), T_world_camera with OpenCV camera axes
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import DataError, FrameError
from uncle.recon.core.frame import Frame


def matches(path: Path) -> bool:
    """Whether the folder looks like a recording of this format."""
    return (path / "camera.json").is_file() and any(path.glob("frame_*.npz"))


def read(path: Path) -> NpzRecording:
    """Open the recording. Raises DataError."""
    files = sorted(path.glob("frame_*.npz"))
    if not files:
        raise DataError(f"{path} holds no frame_*.npz")
    try:
        camera = Camera(**json.loads((path / "camera.json").read_text()))
    except (OSError, ValueError, TypeError) as error:
        raise DataError(f"cannot read {path / 'camera.json'}: {error}") from error
    return NpzRecording(path, files, camera)


class NpzRecording:
    """Implements `uncle.recon.core.frame.Recording`."""

    format = "npz"
    has_timestamps = False
    reference_mesh = None
    registration_sigma_px = 0.0
    notes = ()

    def __init__(self, root: Path, files: list[Path], camera: Camera) -> None:
        self.name, self.files, self.camera = root.resolve().name, files, camera
        with np.load(files[0]) as first:
            self.sensors = tuple(key.removeprefix("depth_") for key in first if key.startswith("depth_"))
        self.has_poses = self.pose(0) is not None

    def __len__(self) -> int:
        return len(self.files)

    def __getitem__(self, index: int) -> Frame:
        depths = {sensor: self.depth(index, sensor) for sensor in self.sensors}
        return Frame(index, self.timestamp(index), self.color(index), depths, self.pose(index))

    def timestamp(self, index: int) -> float:
        """The index: the format has no clock."""
        return float(index)

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera or None."""
        pose = self._array(index, "pose")
        return None if pose is None else pose.astype(np.float64)

    def color(self, index: int) -> Tensor:
        """(H, W, 3) uint8 RGB. Raises FrameError."""
        color = self._array(index, "color")
        if color is None:
            raise FrameError(f"frame {index}: {self.files[index]} holds no array `color`")
        return torch.from_numpy(color)

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement. Raises FrameError."""
        depth = self._array(index, f"depth_{sensor}")
        if depth is None:
            return torch.zeros(self.camera.height, self.camera.width)
        return torch.from_numpy(depth.astype(np.float32))

    def _array(self, index: int, key: str) -> np.ndarray[Any, Any] | None:
        try:
            with np.load(self.files[index]) as arrays:
                return arrays.get(key)
        except (OSError, ValueError) as error:
            raise FrameError(f"frame {index}: cannot read {self.files[index]}: {error}") from error
