"""What every tracker offers; and the one that takes the poses of the recording."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from torch import Tensor

from ..core.errors import DataError
from ..core.frame import Frame
from ..run.tracking_record import TrackingRecord


class Tracker(Protocol):
    """Finds T_world_camera (4, 4) of frame after frame."""

    def prepare(self, frame: Frame, normals: dict[str, Tensor]) -> Any:
        """What can be made of a frame in the background, before its turn; normals (H, W, 3) by sensor."""

    def track(self, frame: Frame, prepared: Any, inputs: dict[str, Tensor]) -> np.ndarray | None:
        """The pose, or None if the frame must not enter the map."""

    def is_keyframe(self) -> bool:
        """Whether the frame tracked last matters most for the map."""

    def poses(self) -> dict[int, np.ndarray]:
        """What is known by now of all frames, by index."""

    def finish(self) -> dict[int, np.ndarray]:
        """All poses, made consistent once more when the last frame was seen."""

    def record(self) -> TrackingRecord | None:
        """How sure the poses are; None if nothing was tracked."""

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state."""


class GivenPoses:
    """The poses of the recording. A frame without one is left out of the map."""

    def prepare(self, frame: Frame, normals: dict[str, Tensor]) -> None:
        """Nothing is needed."""

    def track(self, frame: Frame, prepared: None, inputs: dict[str, Tensor]) -> np.ndarray | None:
        """The pose of the frame."""
        return frame.T_world_camera

    def is_keyframe(self) -> bool:
        """Every frame counts the same."""
        return True

    def poses(self) -> dict[int, np.ndarray]:
        """None: no pose changes after its frame."""
        return {}

    def finish(self) -> dict[int, np.ndarray]:
        """None: no pose changes."""
        return {}

    def record(self) -> None:
        """None: nothing was tracked."""

    def state_dict(self) -> dict[str, Any]:
        """There is no state."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """There is no state."""

    @staticmethod
    def check(has_any: bool) -> None:
        """Raises DataError if the recording has no poses at all."""
        if not has_any:
            raise DataError("this recording has no camera poses; `uncle map --track` estimates them")


def require_found(poses: dict[int, Any], frames: int) -> None:
    """Raises DataError if the camera was lost in every one of `frames`."""
    if not poses:
        raise DataError(
            f"the camera was lost in all {frames} frames: none has enough depth within range to begin with; check the "
            "depth images, or raise fusion.max_depth_m"
        )
