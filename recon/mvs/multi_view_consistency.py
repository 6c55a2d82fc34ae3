"""Consistency of depth images of several views: distance between their measurements of the same surface points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..core.camera import Camera, project_into


@dataclass(frozen=True)
class ConsistencyParameters:
    """Which views a view is compared with: those that see more than `min_overlap` of it, about `max_views` of them."""

    min_overlap: float = 0.3
    max_views: int = 12


class PosedDepth(Protocol):
    """depth (H, W) metres, 0 = no measurement, and the pose T_world_camera (4, 4) of its camera."""

    @property
    def depth(self) -> np.ndarray:
        """(H, W) metres."""
        ...

    @property
    def T_world_camera(self) -> np.ndarray:
        """(4, 4) pose."""
        ...


def cross_view_residual(
    camera: Camera,
    images: Sequence[PosedDepth],
    reference: int,
    pixels: np.ndarray,
    parameters: ConsistencyParameters = ConsistencyParameters(),
) -> tuple[np.ndarray, np.ndarray]:
    """Median distance between the depth at `pixels` (N,) of images[reference] and what the other views measure there.

    Returns (N,) metres, infinite without observing views, and (N,) the number of observing views. A point that is
    occluded in some view has a large residual there; the median ignores it as long as such views are a minority.
    """
    image = images[reference]
    local = camera.rays().view(-1, 3).numpy()[pixels] * image.depth.ravel()[pixels, None]
    world = local @ image.T_world_camera[:3, :3].T + image.T_world_camera[:3, 3]
    residuals = []
    for other in _observing_views(camera, images, reference, parameters):
        inside, projected, z = project_into(world, camera, other.T_world_camera)
        measured = other.depth[projected[:, 1], projected[:, 0]]
        residual = np.full(len(world), np.inf)
        residual[inside] = np.where(measured > 0, np.abs(z - measured), np.inf)
        residuals.append(residual)
    if not residuals:
        return np.full(len(pixels), np.inf), np.zeros(len(pixels), np.int64)
    ordered = np.sort(np.stack(residuals), axis=0)
    count = np.isfinite(ordered).sum(0)
    return ordered[np.maximum(count - 1, 0) // 2, np.arange(len(pixels))], count


def _observing_views(
    camera: Camera, images: Sequence[PosedDepth], reference: int, parameters: ConsistencyParameters
) -> list[PosedDepth]:
    """Images that overlap with images[reference], evenly thinned.

    Not restricted to the source images of a stereo match: an image and its source can share the same false match.
    """
    image = images[reference]
    measured = image.depth[image.depth > 0]
    if not len(measured):
        return []
    poses = np.stack([other.T_world_camera for other in images])
    overlap = view_overlap(camera, poses, image.T_world_camera, float(np.median(measured)))
    overlaps = overlap > parameters.min_overlap
    overlaps[reference] = False
    rows = np.flatnonzero(overlaps)
    return [images[row] for row in rows[:: 1 + len(rows) // parameters.max_views]]


_SIDE = 0.7  # of the half image: position of the outer probe points


def view_overlap(camera: Camera, poses: np.ndarray, T_world_reference: np.ndarray, distance_m: float) -> np.ndarray:
    """(N,) fraction of 3 x 3 points `distance_m` in front of a reference camera that each of `poses` (N, 4, 4) sees."""
    spread = np.array([-_SIDE, 0.0, _SIDE])
    x, y = (axis.ravel() for axis in np.meshgrid(spread * camera.cx / camera.fx, spread * camera.cy / camera.fy))
    points = np.stack([x, y, np.ones_like(x)], -1) * distance_m @ T_world_reference[:3, :3].T
    points = points + T_world_reference[:3, 3]
    # Own projection: all poses at once, and points beside the image count by their exact position, not their pixel.
    local = (points[None] - poses[:, None, :3, 3]) @ poses[:, :3, :3]
    z = np.maximum(local[..., 2], 1e-6)
    u, v = camera.fx * local[..., 0] / z + camera.cx, camera.fy * local[..., 1] / z + camera.cy
    seen = (local[..., 2] > 0.1) & (u > 0) & (v > 0) & (u < camera.width) & (v < camera.height)
    fraction: np.ndarray = seen.mean(1)
    return fraction
