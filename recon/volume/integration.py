"""One depth image into the running sums of the map: the innermost loop of the program, compiled.

The same arithmetic stands in `integrate_tensors` as plain tensor operations: for accelerators, and as the oracle of the
tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numba import njit
from torch import Tensor

from ..core.camera import Camera
from ..core.threads import share_out
from .sparse_grid import BLOCK, ROWS

MIN_Z_M = 0.05
_BLOCKS_AT_A_TIME = 2048
_SURE = 17.0  # exp(-17) is nothing beside 1 in single precision


@dataclass(frozen=True)
class Observation:
    """A depth image as the map takes it; images (H, W) float32, metres, of weights, or None.

    `weight`: of each reading near its surface, None = 1. `free_weight` and `free_space_scale_m`: of free space
    far before the reading, and the distance on which it is reached; None = `weight` there, too. color: (H, W, 3) uint8.
    """

    depth: Tensor
    weight: Tensor | None
    free_weight: Tensor | None
    free_space_scale_m: Tensor | None
    color: Tensor | None
    T_camera_world: Tensor


@dataclass(frozen=True)
class Bounds:
    """Truncation of the distances and the farthest reading that takes part, metres."""

    truncation_m: float
    max_depth_m: float


def integrate(
    sums: Tensor, color_sums: Tensor, ids: Tensor, corners: Tensor, steps: Tensor, seen: Observation, camera: Camera,
    bounds: Bounds, sign: float,
) -> None:  # fmt: skip
    """Add (`sign` 1) or take out (-1) an observation in place.

    sums, color_sums (R, 4) as in `TsdfVolume`; ids (M,) blocks in view; corners (M, 3) first samples of those, world,
    metres; steps (512, 3) offsets of the samples of a block.
    """
    if sums.device.type == "cpu":
        _integrate_compiled(sums, color_sums, ids, corners, steps, seen, camera, bounds, sign)
    else:
        integrate_tensors(sums, color_sums, ids, corners, steps, seen, camera, bounds, sign)


def integrate_tensors(
    sums: Tensor, color_sums: Tensor, ids: Tensor, corners: Tensor, steps: Tensor, seen: Observation, camera: Camera,
    bounds: Bounds, sign: float,
) -> None:  # fmt: skip
    """`integrate` on any device."""
    chunks = zip(ids.split(_BLOCKS_AT_A_TIME), corners.split(_BLOCKS_AT_A_TIME), strict=True)
    for part, corner in chunks:
        rows, pixels, sdf = _readings(part, corner, steps, seen, camera, bounds)
        w = torch.ones_like(sdf) if seen.weight is None else seen.weight.view(-1)[pixels]
        if seen.free_weight is not None and seen.free_space_scale_m is not None:
            beyond = sdf - bounds.truncation_m
            sure = 1 - torch.exp(-beyond.clamp(min=0) / seen.free_space_scale_m.view(-1)[pixels].clamp(min=1e-6))
            w = torch.where(beyond >= 0, seen.free_weight.view(-1)[pixels] * sure, w)
        sdf = sdf.clamp(max=bounds.truncation_m)
        sums[rows] += sign * torch.stack([w, w * sdf, w * sdf * sdf, torch.ones_like(sdf)], -1)
        if seen.color is not None:
            near = sdf.abs() < 0.5 * bounds.truncation_m
            rows, w, rgb = rows[near], w[near, None], seen.color.view(-1, 3)[pixels[near]].float()
            color_sums[rows] += sign * torch.cat([w, w * rgb], -1)


def _readings(
    ids: Tensor, corners: Tensor, steps: Tensor, seen: Observation, camera: Camera, bounds: Bounds
) -> tuple[Tensor, Tensor, Tensor]:
    """For the samples of blocks `ids` that get a reading: their rows, the pixel of it, and its distance before it."""
    rotation, depth = seen.T_camera_world[:3, :3], seen.depth
    corner = corners @ rotation.T + seen.T_camera_world[:3, 3]
    inner = steps @ rotation.T
    x, y, z = (corner[:, axis, None] + inner[:, axis] for axis in range(3))
    inverse = 1 / z.clamp(min=1e-3)
    u = (x * inverse * camera.fx + (camera.cx + 0.5)).floor_()
    v = (y * inverse * camera.fy + (camera.cy + 0.5)).floor_()
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & (z > MIN_Z_M)
    samples = inside.view(-1).nonzero()[:, 0]
    pixels = (v.view(-1)[samples] * camera.width + u.view(-1)[samples]).long()
    reading = depth.reshape(-1)[pixels]
    sdf = reading - z.view(-1)[samples]
    kept = (reading > 0) & (reading < bounds.max_depth_m) & (sdf > -bounds.truncation_m)
    samples, pixels = samples[kept], pixels[kept]
    rows = ids[samples // ROWS] * ROWS + samples % ROWS
    return rows, pixels, sdf[kept]


def _integrate_compiled(sums, color_sums, ids, corners, steps, seen, camera, bounds, sign) -> None:
    """Blocks are shared out to threads; each has samples of its own."""
    rotation = seen.T_camera_world[:3, :3]
    corners = (corners @ rotation.T + seen.T_camera_world[:3, 3]).numpy()
    nothing = torch.zeros(0, 0)
    given = (
        (steps @ rotation.T).numpy(),
        *(_image(seen.depth if image is None else image) for image in (seen.depth, seen.weight)),
        *(_image(nothing if image is None else image) for image in (seen.free_weight, seen.free_space_scale_m)),
        np.zeros((0, 0, 3), np.uint8) if seen.color is None else np.ascontiguousarray(seen.color.numpy()),
        seen.weight is not None,
        np.array([camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5], np.float32),
        np.float32(bounds.truncation_m), np.float32(bounds.max_depth_m), np.float32(sign),
    )  # fmt: skip

    def add(blocks: slice) -> None:
        _add(sums.numpy(), color_sums.numpy(), ids.numpy()[blocks], corners[blocks], *given)

    share_out(add, len(ids))


def _image(values: Tensor) -> np.ndarray:
    return np.ascontiguousarray(values.numpy(), dtype=np.float32)


@njit(nogil=True, cache=True)
def _add(
    sums, color_sums, ids, corners, steps, depth, weight, free_weight, doubt, color, weighted, pinhole, truncation,
    farthest, sign,
):  # fmt: skip
    """corners (M, 3) and steps (512, 3) in camera axes; pinhole: fx, fy and the principal point from a pixel's corner.

    Images that are missing have no element.
    """
    height, width = depth.shape
    one, nothing = np.float32(1.0), np.float32(0.0)
    half, least_z, sure_at = np.float32(0.5) * truncation, np.float32(MIN_Z_M), np.float32(_SURE)
    for block in range(len(ids)):
        first = ids[block] * ROWS
        for sample in range(BLOCK**3):
            z = corners[block, 2] + steps[sample, 2]
            if z <= least_z:
                continue
            inverse = one / z
            u = (corners[block, 0] + steps[sample, 0]) * inverse * pinhole[0] + pinhole[2]
            v = (corners[block, 1] + steps[sample, 1]) * inverse * pinhole[1] + pinhole[3]
            if not (u >= nothing and u < width and v >= nothing and v < height):
                continue
            row, column = int(v), int(u)
            reading = depth[row, column]
            distance = reading - z
            if reading <= nothing or reading >= farthest or distance <= -truncation:
                continue
            w = weight[row, column] if weighted else one
            if distance >= truncation:
                if free_weight.size:
                    ratio = (distance - truncation) / max(doubt[row, column], np.float32(1e-6))
                    w = free_weight[row, column] * (one if ratio > sure_at else one - np.exp(-ratio))
                distance = truncation
            w *= sign
            at = first + sample
            sums[at, 0] += w
            sums[at, 1] += w * distance
            sums[at, 2] += w * distance * distance
            sums[at, 3] += sign
            if color.size and abs(distance) < half:
                color_sums[at, 0] += w
                for channel in range(3):
                    color_sums[at, 1 + channel] += w * np.float32(color[row, column, channel])
