"""Colour of a mesh against the images of frames that were held out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..core.camera import Camera
from ..core.errors import DataError
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface

UNSEEN = 128  # grey: what vertices have of which no colour was seen
MIN_SQUARE = 1 / (12 * 255**2)  # of what rounding to whole numbers leaves


@dataclass(frozen=True)
class HeldOutColor:
    """Colours of the mesh against images, over the pixels where the mesh is; None if it is at none.

    psnr_db        -10 log10 of the mean squared difference of colours in 0..1, mean over the frames
    l1             mean |difference| of colours in 0..1, mean over the frames
    completeness   share of the pixels where the mesh is
    """

    psnr_db: float | None
    l1: float | None
    completeness: float
    frames: int


def held_out_color(mesh: Mesh, camera: Camera, frames: Iterable[tuple[np.ndarray, np.ndarray]]) -> HeldOutColor:
    """Colour of `mesh` seen at the poses of `frames`, without light or shade, against what they show.

    `frames` yields T_world_camera (4, 4) and color (H, W, 3) uint8. Raises DataError if the mesh has no colours,
    or that of a map without any.
    """
    if mesh.colors is None or (mesh.colors == UNSEEN).all():
        raise DataError("the mesh has no colours")
    surface, painted = Surface(mesh), mesh.colors.astype(np.float32) / 255
    squares, absolutes, shares = [], [], []
    for T_world_camera, color in frames:
        triangles, weights = surface.triangles(camera, T_world_camera)
        met = triangles >= 0
        shares.append(met.mean())
        if not met.any():
            continue
        found = np.einsum("pc,pcx->px", weights[met], painted[mesh.faces[triangles[met]]])
        difference = (found - color[met].astype(np.float32) / 255).astype(np.float64)
        squares.append(max(np.square(difference).mean(), MIN_SQUARE))
        absolutes.append(np.abs(difference).mean())
    return HeldOutColor(
        float(-10 * np.log10(squares).mean()) if squares else None,
        float(np.mean(absolutes)) if absolutes else None,
        float(np.mean(shares)) if shares else 0.0,
        len(shares),
    )
