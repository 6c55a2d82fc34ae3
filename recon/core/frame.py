"""A frame of a recording, and what every recording must offer."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from torch import Tensor

from .camera import Camera


@dataclass(frozen=True)
class Frame:
    """One instant of a recording. All sensors share the camera of the recording.

    color            (H, W, 3) uint8 RGB
    depths           sensor name -> (H, W) float32 z-depth in metres, 0 where there is no measurement
    T_world_camera   (4, 4) float64, OpenCV camera axes, metres; None where the recording has no (finite) pose
    timestamp        seconds, or the frame index where the recording has no clock
    """

    index: int
    timestamp: float
    color: Tensor
    depths: dict[str, Tensor]
    T_world_camera: np.ndarray | None


class Recording(Protocol):
    """A sequence of frames with the facts that hold for all of them.

    `recording[i]` raises `FrameError` if that one frame cannot be read; the recording stays usable. The parts of a
    frame can be had one by one, so that one bad image costs no more than itself; several threads may read at once.
    """

    name: str
    format: str  # the name of the reader
    sensors: tuple[str, ...]
    has_poses: bool
    has_timestamps: bool
    reference_mesh: Path | None  # ground-truth surface in the recording's world frame
    notes: tuple[str, ...]  # facts to report to the user once: default intrinsics, dropped frames

    @property
    def camera(self) -> Camera:
        """The pinhole camera of all images."""

    @property
    def registration_sigma_px(self) -> float:
        """How far colour may lie beside its depth, by an error that all frames share."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int) -> Frame: ...

    def timestamp(self, index: int) -> float:
        """Seconds; the frame number where `has_timestamps` is False."""

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera, or None where it is unknown."""

    def color(self, index: int) -> Tensor:
        """(H, W, 3) uint8 RGB. Raises FrameError."""

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement. Raises FrameError."""


GROUND_TRUTH_SENSOR = "gt"
