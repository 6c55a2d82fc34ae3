"""A voxel size that fits the depth and the noise of a recording (docs/method.md, "Voxel size")."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .depth_statistics import DepthFacts, DepthImages, depth_facts

IMAGES = 12  # of each sensor, spread over the recording
ROOM_VOXEL_M = 0.02
ROOM_DEPTH_M = (0.8, 4.0)  # median depth of recordings that keep the voxel of rooms
SHARE_OF_MEDIAN = 0.01  # voxel of closer or farther scenes
SHARE_OF_BACKGROUND = 0.0025  # at least this share of the depth of the background: memory grows with its area
SERIES = (1.0, 2.0, 5.0, 10.0)


@dataclass(frozen=True)
class VoxelSize:
    """A voxel size in metres, and why."""

    size_m: float
    reason: str


def choose_voxel_size(frames: DepthImages, count: int, sensors: Iterable[str], max_depth_m: float) -> VoxelSize:
    """The size that fits `count` frames of `sensors`; measurements beyond `max_depth_m` are ignored."""
    step = max(1, (count - 1) // max(1, IMAGES - 1))
    indices = range(0, count, step)[:IMAGES]
    facts = [depth_facts(frames, sensor, indices, max_depth_m) for sensor in sensors]
    return fitting_voxel_size([one for one in facts if one is not None])


def fitting_voxel_size(facts: Sequence[DepthFacts]) -> VoxelSize:
    """The size that fits the depth of some sensors of one scene: of the one in the middle, and of the least noise.

    Rooms have 2 cm. A scene whose median depth is smaller or larger has 1 % of that, but not less than the noise of a
    pixel or 0.25 % of the depth of the background; 1, 2 or 5 times a power of ten, from 1 mm to 50 cm.
    """
    if not facts:
        return VoxelSize(ROOM_VOXEL_M, "no depth is known")
    of_median = sorted(facts, key=lambda one: one.quantiles[1])[len(facts) // 2]
    _, median, background = of_median.quantiles
    if ROOM_DEPTH_M[0] <= median <= ROOM_DEPTH_M[1]:
        return VoxelSize(ROOM_VOXEL_M, f"median depth {median:.2f} m")
    reason, wanted = max(
        ((reason, size) for reason, size in (
            (f"median depth {median:.2f} m", SHARE_OF_MEDIAN * median),
            (f"noise of a pixel {1000 * min(one.noise_m for one in facts):.1f} mm", min(one.noise_m for one in facts)),
            (f"background at {background:.1f} m", SHARE_OF_BACKGROUND * background),
        )), key=lambda one: one[1])  # fmt: skip
    size = in_series(wanted)
    return VoxelSize(min(size, ROOM_VOXEL_M) if median < ROOM_DEPTH_M[0] else max(size, ROOM_VOXEL_M), reason)


def in_series(size_m: float) -> float:
    """The nearest 1, 2 or 5 times a power of ten by ratio, from 0.001 to 0.5."""
    power = 10.0 ** math.floor(math.log10(size_m))
    nearest = min(SERIES, key=lambda factor: abs(math.log(size_m / (factor * power))))
    return float(min(max(round(nearest * power, 6), 0.001), 0.5))
