"""Adds one depth image to the running sums of the map: the innermost loop of the program, compiled.

`integrate_tensors` does the same as plain tensor operations, for GPUs; the tests compare the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.compiled import compiled
from ..core.threads import share_out
from .sparse_grid import BLOCK, ROWS

MIN_Z_M = 0.05
_BLOCKS_AT_A_TIME = 2048
_MAX_EXPONENT = 17.0  # 1 - exp(-17) is 1 in single precision


@dataclass(frozen=True)
class Observation:
    """A depth image and its weights; images (H, W) float32.

    depth                            metres, 0 = no measurement
    weight                           of each pixel near its surface; None = 1
    free_weight, free_space_scale_m  weight of the free space in front of it, and its scale (`FreeSpace`), metres;
                                     None = `weight` there, too
    color                            (H, W, 3) uint8, or None
    """

    depth: Tensor
    weight: Tensor | None
    free_weight: Tensor | None
    free_space_scale_m: Tensor | None
    color: Tensor | None
    T_camera_world: Tensor


@dataclass(frozen=True)
class Bounds:
    """Truncation of the distances, and the depth beyond which measurements are ignored, metres."""

    truncation_m: float
    max_depth_m: float


def integrate(
    sums: Tensor, color_sums: Tensor, ids: Tensor, corners: Tensor, steps: Tensor, image: Observation, camera: Camera,
    bounds: Bounds, sign: float,
) -> None:  # fmt: skip
    """Add (`sign` 1) or subtract (-1) an observation in place.

    sums, color_sums (R, 4) as in `TsdfVolume`; ids (M,) blocks in view; corners (M, 3) first samples of those, world,
    metres; steps (512, 3) offsets of the samples of a block.
    """
    if sums.device.type == "cpu":
        _integrate_compiled(sums, color_sums, ids, corners, steps, image, camera, bounds, sign)
    else:
        integrate_tensors(sums, color_sums, ids, corners, steps, image, camera, bounds, sign)


def integrate_tensors(
    sums: Tensor, color_sums: Tensor, ids: Tensor, corners: Tensor, steps: Tensor, image: Observation, camera: Camera,
    bounds: Bounds, sign: float,
) -> None:  # fmt: skip
    """`integrate` on any device."""
    chunks = zip(ids.split(_BLOCKS_AT_A_TIME), corners.split(_BLOCKS_AT_A_TIME), strict=True)
    for part, corner in chunks:
        rows, pixels, sdf = _observed_samples(part, corner, steps, image, camera, bounds)
        w = torch.ones_like(sdf) if image.weight is None else image.weight.view(-1)[pixels]
        if image.free_weight is not None and image.free_space_scale_m is not None:
            in_front, scale = sdf - bounds.truncation_m, image.free_space_scale_m.view(-1)[pixels].clamp(min=1e-6)
            certainty = 1 - torch.exp(-in_front.clamp(min=0) / scale)
            w = torch.where(in_front >= 0, image.free_weight.view(-1)[pixels] * certainty, w)
        sdf = sdf.clamp(max=bounds.truncation_m)
        sums[rows] += sign * torch.stack([w, w * sdf, w * sdf * sdf, torch.ones_like(sdf)], -1)
        if image.color is not None:
            near = sdf.abs() < 0.5 * bounds.truncation_m
            rows, w, rgb = rows[near], w[near, None], image.color.view(-1, 3)[pixels[near]].float()
            color_sums[rows] += sign * torch.cat([w, w * rgb], -1)


def _observed_samples(
    ids: Tensor, corners: Tensor, steps: Tensor, image: Observation, camera: Camera, bounds: Bounds
) -> tuple[Tensor, Tensor, Tensor]:
    """The samples of blocks `ids` that are observed: rows (K,), pixels (K,), and signed distances (K,) metres."""
    rotation, depth = image.T_camera_world[:3, :3], image.depth
    corner = corners @ rotation.T + image.T_camera_world[:3, 3]
    inner = steps @ rotation.T
    x, y, z = (corner[:, axis, None] + inner[:, axis] for axis in range(3))
    inverse = 1 / z.clamp(min=1e-3)
    u = (x * inverse * camera.fx + (camera.cx + 0.5)).floor_()
    v = (y * inverse * camera.fy + (camera.cy + 0.5)).floor_()
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & (z > MIN_Z_M)
    samples = inside.view(-1).nonzero()[:, 0]
    pixels = (v.view(-1)[samples] * camera.width + u.view(-1)[samples]).long()
    measured = depth.reshape(-1)[pixels]
    sdf = measured - z.view(-1)[samples]
    kept = (measured > 0) & (measured < bounds.max_depth_m) & (sdf > -bounds.truncation_m)
    samples, pixels = samples[kept], pixels[kept]
    rows = ids[samples // ROWS] * ROWS + samples % ROWS
    return rows, pixels, sdf[kept]


def _integrate_compiled(
    sums: Tensor, color_sums: Tensor, ids: Tensor, corners: Tensor, steps: Tensor, image: Observation, camera: Camera,
    bounds: Bounds, sign: float,
) -> None:  # fmt: skip
    """Blocks are distributed over threads; each has its own samples."""
    rotation = image.T_camera_world[:3, :3]
    local_corners = (corners @ rotation.T + image.T_camera_world[:3, 3]).numpy()
    arguments = (
        (steps @ rotation.T).numpy(), _array(image.depth),
        _array(image.depth if image.weight is None else image.weight), _array(image.free_weight),
        _array(image.free_space_scale_m),
        np.zeros((0, 0, 3), np.uint8) if image.color is None else np.ascontiguousarray(image.color.numpy()),
        image.weight is not None,
        np.array([camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5], np.float32),
        np.float32(bounds.truncation_m), np.float32(bounds.max_depth_m), np.float32(sign),
    )  # fmt: skip

    def add(blocks: slice) -> None:
        _add(sums.numpy(), color_sums.numpy(), ids.numpy()[blocks], local_corners[blocks], *arguments)

    share_out(add, len(ids))


def _array(values: Tensor | None) -> np.ndarray:
    """(H, W) float32, or an array without elements."""
    return np.zeros((0, 0), np.float32) if values is None else np.ascontiguousarray(values.numpy(), dtype=np.float32)


@compiled()
def _add(
    sums: np.ndarray, color_sums: np.ndarray, ids: np.ndarray, corners: np.ndarray, steps: np.ndarray,
    depth: np.ndarray, weight: np.ndarray, free_weight: np.ndarray, free_scale: np.ndarray, color: np.ndarray,
    weighted: bool, pinhole: np.ndarray, truncation: np.float32, farthest: np.float32, sign: np.float32,
) -> None:  # fmt: skip
    """corners (M, 3) and steps (512, 3) in camera axes; pinhole: fx, fy and the principal point from a pixel's corner.

    Missing images have no element.
    """
    height, width = depth.shape
    one, nothing = np.float32(1.0), np.float32(0.0)
    half, least_z, max_exponent = np.float32(0.5) * truncation, np.float32(MIN_Z_M), np.float32(_MAX_EXPONENT)
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
            measured = depth[row, column]
            distance = measured - z
            if measured <= nothing or measured >= farthest or distance <= -truncation:
                continue
            w = weight[row, column] if weighted else one
            if distance >= truncation:
                if free_weight.size:
                    ratio = (distance - truncation) / max(free_scale[row, column], np.float32(1e-6))
                    w = free_weight[row, column] * (one if ratio > max_exponent else one - np.exp(-ratio))
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
