"""How far depth images of several views agree about the same places."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..core.camera import Camera, project_into

MIN_OBSERVER_OVERLAP, MAX_OBSERVING_VIEWS = 0.3, 12


_SIDE = 0.7  # of the half image: where points are taken that a source should see


class PosedDepth(Protocol):
    """depth (H, W) metres, 0 = none, and where it was taken."""

    depth: np.ndarray
    T_world_camera: np.ndarray


def cross_view_residual(
    camera: Camera, images: Sequence[PosedDepth], which: int, pixels: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """How far the depth at `pixels` (N,) of an image lies from what others measure at the same place, metres.

    (N,) medians over the other images that look there, and their number. A point behind another surface is far off
    in the images that see that surface; the median leaves them out as long as they are few.
    """
    image = images[which]
    local = camera.rays().view(-1, 3).numpy()[pixels] * image.depth.ravel()[pixels, None]
    world = local @ image.T_world_camera[:3, :3].T + image.T_world_camera[:3, 3]
    misses = []
    for other in _observing_views(camera, images, which):
        inside, pixels_there, z = project_into(world, camera, other.T_world_camera)
        measured = other.depth[pixels_there[:, 1], pixels_there[:, 0]]
        miss = np.full(len(world), np.inf)
        miss[inside] = np.where(measured > 0, np.abs(z - measured), np.inf)
        misses.append(miss)
    if not misses:
        return np.full(len(pixels), np.inf), np.zeros(len(pixels), np.int64)
    ordered = np.sort(np.stack(misses), axis=0)
    count = np.isfinite(ordered).sum(0)
    return ordered[np.maximum(count - 1, 0) // 2, np.arange(len(pixels))], count


def _observing_views(camera: Camera, images: Sequence[PosedDepth], which: int) -> list[PosedDepth]:
    """Images that see much of this one, evenly spread.

    Not its sources alone: an image and its source may agree on the same false match.
    """
    image = images[which]
    known = image.depth[image.depth > 0]
    if not len(known):
        return []
    poses = np.stack([other.T_world_camera for other in images])
    sees = view_overlap(camera, poses, image.T_world_camera, float(np.median(known))) > MIN_OBSERVER_OVERLAP
    sees[which] = False
    rows = np.flatnonzero(sees)
    return [images[row] for row in rows[:: 1 + len(rows) // MAX_OBSERVING_VIEWS]]


def view_overlap(camera: Camera, poses: np.ndarray, here: np.ndarray, distance_m: float) -> np.ndarray:
    """(N,) share of points at `distance_m` before the camera `here` that each of `poses` (N, 4, 4) sees."""
    spread = np.array([-_SIDE, 0.0, _SIDE])
    x, y = (axis.ravel() for axis in np.meshgrid(spread * camera.cx / camera.fx, spread * camera.cy / camera.fy))
    points = np.stack([x, y, np.ones_like(x)], -1) * distance_m @ here[:3, :3].T + here[:3, 3]
    there = (points[None] - poses[:, None, :3, 3]) @ poses[:, :3, :3]
    z = np.maximum(there[..., 2], 1e-6)
    u, v = camera.fx * there[..., 0] / z + camera.cx, camera.fy * there[..., 1] / z + camera.cy
    seen = (there[..., 2] > 0.1) & (u > 0) & (v > 0) & (u < camera.width) & (v < camera.height)
    return seen.mean(1)
