"""The box of the scene, found from what the sensors see; nobody has to set it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from ...core.camera import Camera
from ...core.config.nice import NiceConfig
from ...core.errors import ConfigError, DataError
from ...run.frames import RunFrames

VIEWS = 100  # asked at most
STRIDE = 8  # pixels
TAILS = 0.002  # of the readings on each side are outliers
MARGIN_M = 0.4  # around what is seen
AROUND_CAMERA_M = 0.6


def set_bound(config: NiceConfig) -> Tensor | None:
    """The box (2, 3) of the settings, or None. Raises ConfigError."""
    if not config.bound:
        return None
    values = torch.tensor(config.bound)
    if len(values) != 6 or not bool((values[0::2] < values[1::2]).all()):
        raise ConfigError("setting nice.bound: give six numbers x0, x1, y0, y1, z0, z1 with x0 < x1, y0 < y1, z0 < z1")
    return torch.stack([values[0::2], values[1::2]])


def bound_of(frames: RunFrames, indices: Sequence[int], max_depth_m: float) -> Tensor:
    """(2, 3) metres around what all sensors see from the given poses. Raises DataError if they see nothing."""
    chosen = np.unique(np.linspace(0, len(indices) - 1, min(VIEWS, len(indices))).astype(int))
    parts, centres = [], []
    for position in chosen:
        index = indices[position]
        T = frames.pose(index)
        depths = [frames.depth(index, sensor) for sensor in frames.sensors]
        parts += [points_of(depth, frames.camera, T, max_depth_m) for depth in depths]
        centres.append(T[:3, 3])
    points = np.concatenate(parts)
    if not len(points):
        raise DataError("no frame could be mapped: no depth reading within range has a camera pose")
    return around(points, np.array(centres))


def around(points: np.ndarray, centres: np.ndarray) -> Tensor:
    """(2, 3) metres around points (N, 3), but for outliers, and cameras (M, 3)."""
    low = np.minimum(np.quantile(points, TAILS, axis=0) - MARGIN_M, centres.min(0) - AROUND_CAMERA_M)
    high = np.maximum(np.quantile(points, 1 - TAILS, axis=0) + MARGIN_M, centres.max(0) + AROUND_CAMERA_M)
    return torch.from_numpy(np.stack([low, high])).float()


def points_of(depth: Tensor, camera: Camera, T_world_camera: np.ndarray, max_depth_m: float) -> np.ndarray:
    """(H, W) metres -> (N, 3) readings in the world, every `STRIDE`-th pixel."""
    metres = depth[::STRIDE, ::STRIDE].numpy()
    rays = camera.rays().numpy()[::STRIDE, ::STRIDE]
    used = (metres > 0) & (metres < max_depth_m)
    local = rays[used] * metres[used][:, None]
    return local @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
