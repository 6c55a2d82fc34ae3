"""A recording read in another way than its files state: other units, intrinsics, pose convention or clock."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from scipy.spatial.transform import Rotation, Slerp
from torch import Tensor

from .camera import Camera
from .frame import Frame, Recording
from .se3 import inverse
from .world_offset import NO_OFFSET, Offset

OPENGL_AXES = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Correction:
    """What differs from the input as stated; the default changes nothing.

    depth_factor             multiplies depth
    translation_factor       multiplies the positions of the camera
    focal_x, focal_y         multiply the focal lengths
    shift_x, shift_y         added to the principal point, pixels
    color_x, color_y         added to the position of every pixel of colour, pixels
    lag                      frames by which poses are late: frame i has the pose of i + lag
    is_along_ray             depth is a distance from the camera centre instead of along the optical axis
    is_inverted, is_opengl   poses are camera from world; camera axes are right, up, backwards
    offset_m                 position of the world's new origin, subtracted from those of the camera after all else
    """

    depth_factor: float = 1.0
    translation_factor: float = 1.0
    focal_x: float = 1.0
    focal_y: float = 1.0
    shift_x: float = 0.0
    shift_y: float = 0.0
    color_x: float = 0.0
    color_y: float = 0.0
    lag: float = 0.0
    is_along_ray: bool = False
    is_inverted: bool = False
    is_opengl: bool = False
    offset_m: Offset = NO_OFFSET

    def camera(self, stated: Camera) -> Camera:
        """The camera to use instead of the stated one."""
        return Camera(
            stated.width, stated.height,
            stated.fx * self.focal_x, stated.fy * self.focal_y, stated.cx + self.shift_x, stated.cy + self.shift_y,
        )  # fmt: skip

    def poses(self, stated: np.ndarray) -> np.ndarray:
        """T_world_camera (F, 4, 4) of all frames from the stated poses; NaN where a frame has none."""
        poses = inverse(stated) if self.is_inverted else stated.copy()
        poses[:, :3, 3] *= self.translation_factor
        if self.is_opengl:
            poses = poses @ OPENGL_AXES
        poses = poses if self.lag == 0.0 else shifted_poses(poses, self.lag)
        poses[:, :3, 3] -= self.offset_m
        return poses

    def describe(self) -> dict[str, Any]:
        """The fields that differ from the default."""
        default = Correction()
        return {name: value for name, value in vars(self).items() if value != getattr(default, name)}


def shifted_poses(poses: np.ndarray, lag: float) -> np.ndarray:
    """Poses (F, 4, 4) at the positions i + lag, interpolated; NaN beyond the ends and beside missing poses."""
    known = np.isfinite(poses).all((1, 2))
    positions = np.arange(len(poses)) + lag
    result = np.full_like(poses, np.nan)
    if known.sum() < 2:
        return result
    times = np.flatnonzero(known).astype(float)
    inside = (positions >= times[0]) & (positions <= times[-1])
    low = np.clip(np.floor(positions).astype(int), 0, len(poses) - 1)
    high = np.clip(np.ceil(positions).astype(int), 0, len(poses) - 1)
    inside &= known[low] & known[high]
    if inside.any():
        wanted = positions[inside]
        result[inside] = np.eye(4)
        result[inside, :3, :3] = Slerp(times, Rotation.from_matrix(poses[known, :3, :3]))(wanted).as_matrix()
        for axis in range(3):
            result[inside, axis, 3] = np.interp(wanted, times, poses[known, axis, 3])
    return result


class PosedFrames(Protocol):
    """Frames that may have poses: a recording, or the frames of a run."""

    def __len__(self) -> int: ...

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera or None."""


def stated_poses(frames: PosedFrames) -> np.ndarray:
    """T_world_camera (F, 4, 4) of all frames, NaN where a frame has none."""
    missing = np.full((4, 4), np.nan)
    poses = [frames.pose(index) for index in range(len(frames))]
    return np.array([missing if pose is None else pose for pose in poses]).reshape(-1, 4, 4)


class CorrectedRecording:
    """The recording with a correction applied; implements `recon.core.frame.Recording`."""

    def __init__(self, recording: Recording, correction: Correction) -> None:
        self.recording, self.correction = recording, correction
        self.name, self.format = recording.name, recording.format
        self.sensors, self.has_poses = recording.sensors, recording.has_poses
        self.has_timestamps = recording.has_timestamps
        self.reference_mesh: Path | None = recording.reference_mesh
        self.notes = recording.notes
        self._poses = correction.poses(stated_poses(recording))

    @property
    def camera(self) -> Camera:
        """The corrected camera."""
        return self.correction.camera(self.recording.camera)

    @property
    def registration_sigma_px(self) -> float:
        """As stated by the recording."""
        return self.recording.registration_sigma_px

    def __len__(self) -> int:
        return len(self.recording)

    def __getitem__(self, index: int) -> Frame:
        index = range(len(self))[index]
        depths = {sensor: self.depth(index, sensor) for sensor in self.sensors}
        return Frame(index, self.timestamp(index), self.color(index), depths, self.pose(index))

    def timestamp(self, index: int) -> float:
        """Seconds, as stated."""
        return self.recording.timestamp(index)

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera or None."""
        pose = self._poses[index]
        return pose if np.isfinite(pose).all() else None

    def color(self, index: int) -> Tensor:
        """(H, W, 3) uint8 RGB, moved; black where nothing is known. Raises FrameError."""
        image = self.recording.color(index)
        x, y = round(self.correction.color_x), round(self.correction.color_y)
        if not x and not y:
            return image
        moved = torch.zeros_like(image)
        height, width = image.shape[:2]
        moved[max(y, 0) : height + min(y, 0), max(x, 0) : width + min(x, 0)] = image[
            max(-y, 0) : height + min(-y, 0), max(-x, 0) : width + min(-x, 0)
        ]
        return moved

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement. Raises FrameError."""
        depth = self.recording.depth(index, sensor) * self.correction.depth_factor
        return depth / self.camera.rays().norm(dim=-1) if self.correction.is_along_ray else depth
