"""The box of the scene from the settings, or from what the sensors see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.nice import NiceConfig
from ...core.errors import ConfigError, DataError
from ...run.frames import RunFrames


@dataclass(frozen=True)
class BoundParameters:
    """How the box is found: frames used at most, every n-th pixel of them, ratio of points that are outliers on each
    side of each axis, and margins around the points and around the cameras, metres."""

    max_frames: int = 100
    pixel_stride: int = 8
    outlier_ratio: float = 0.002
    margin_m: float = 0.4
    camera_margin_m: float = 0.6


PARAMETERS = BoundParameters()


def configured_bound(config: NiceConfig) -> Tensor | None:
    """The box (2, 3) of the settings, or None. Raises ConfigError."""
    if not config.bound:
        return None
    values = torch.tensor(config.bound)
    if len(values) != 6 or not bool((values[0::2] < values[1::2]).all()):
        raise ConfigError("setting nice.bound: give six numbers x0, x1, y0, y1, z0, z1 with x0 < x1, y0 < y1, z0 < z1")
    return torch.stack([values[0::2], values[1::2]])


def bound_of_frames(
    frames: RunFrames, indices: Sequence[int], max_depth_m: float, parameters: BoundParameters = PARAMETERS
) -> Tensor:
    """(2, 3) metres around what all sensors see from the given poses. Raises DataError if they see nothing."""
    count = min(parameters.max_frames, len(indices))
    chosen = np.unique(np.linspace(0, len(indices) - 1, count).astype(int))
    parts, centres = [], []
    for position in chosen:
        index = indices[position]
        T = frames.known_pose(index)
        depths = [frames.depth(index, sensor) for sensor in frames.sensors]
        parts += [backproject(depth, frames.camera, T, max_depth_m, parameters.pixel_stride) for depth in depths]
        centres.append(T[:3, 3])
    points = np.concatenate(parts)
    if not len(points):
        raise DataError("no frame could be mapped: no frame with a pose has a depth within range")
    return bound_around(points, np.array(centres), parameters)


def bound_around(points: np.ndarray, centres: np.ndarray, parameters: BoundParameters = PARAMETERS) -> Tensor:
    """(2, 3) metres around points (N, 3), without outliers, and cameras (M, 3)."""
    margin, camera_margin = parameters.margin_m, parameters.camera_margin_m
    low = np.quantile(points, parameters.outlier_ratio, axis=0) - margin
    high = np.quantile(points, 1 - parameters.outlier_ratio, axis=0) + margin
    low = np.minimum(low, centres.min(0) - camera_margin)
    high = np.maximum(high, centres.max(0) + camera_margin)
    return torch.from_numpy(np.stack([low, high])).float()


def backproject(
    depth: Tensor, camera: Camera, T_world_camera: np.ndarray, max_depth_m: float,
    stride: int = PARAMETERS.pixel_stride,
) -> np.ndarray:  # fmt: skip
    """World points (N, 3) of every `stride`-th pixel of a depth image (H, W) metres, up to `max_depth_m`."""
    metres = depth[::stride, ::stride].numpy()
    rays = camera.rays().numpy()[::stride, ::stride]
    used = (metres > 0) & (metres < max_depth_m)
    local = rays[used] * metres[used][:, None]
    return local @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
