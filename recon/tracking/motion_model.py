"""The expected motion of the camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from ..core.se3 import apply_motion, motion_between
from .localisation import Localisation


class MotionModel:
    """Constant velocity: the camera repeats its last motion, as far as the frames showed it. A lost camera is expected
    where it was localised last.

    velocity (4, 4): motion from one frame to the next; lost_frames: how many were lost since the last one that was not.
    """

    def __init__(self) -> None:
        self.velocity = np.eye(4)
        self.lost_frames = 0

    @property
    def lost(self) -> bool:
        """Whether the last frame was lost."""
        return self.lost_frames > 0

    def predict(self, last: np.ndarray) -> np.ndarray:
        """Expected pose (4, 4) of the frame after the one at `last` (4, 4)."""
        predicted: np.ndarray = last @ self.velocity
        return predicted

    def update(self, last: np.ndarray | None, found: Localisation | None) -> None:
        """Take in the next frame, `found` or lost (None); `last` (4, 4): the pose before, None for the first frame."""
        if found is None:
            self.velocity = np.eye(4)
            self.lost_frames += 1
            return
        motion = np.zeros(6) if last is None or self.lost else found.shown @ motion_between(last, found.pose)
        self.velocity = apply_motion(np.eye(4), motion)
        self.lost_frames = 0

    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {"velocity": torch.from_numpy(self.velocity), "lost_frames": self.lost_frames}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state."""
        self.velocity, self.lost_frames = state["velocity"].numpy(), state["lost_frames"]
