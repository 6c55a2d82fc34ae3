"""Where the camera of a frame is. Today: where the recording says; a tracker takes the same place."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..errors import DataError
from ..frame import Frame


class Tracker(Protocol):
    """Finds T_world_camera (4, 4) of a frame, or None if the frame must not enter the map."""

    def track(self, frame: Frame) -> np.ndarray | None: ...


class GivenPoses:
    """The poses of the recording. A frame without one is left out of the map."""

    def track(self, frame: Frame) -> np.ndarray | None:
        return frame.T_world_camera

    @staticmethod
    def check(has_any: bool) -> None:
        """Raises DataError if the recording has no poses at all."""
        if not has_any:
            raise DataError(
                "this recording has no camera poses, and tracking is not part of this version; "
                "add poses to the data set (docs/own-data.md)"
            )
