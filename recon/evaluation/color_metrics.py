"""Colour of a mesh against the images of held-out frames."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..core.camera import Camera
from ..core.errors import DataError
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface

UNSEEN_GREY = 128  # colour of the vertices that no image showed
MIN_SQUARED_ERROR = 1 / (12 * 255**2)  # variance of rounding to 8 bits: bounds the PSNR of a perfect match


@dataclass(frozen=True)
class HeldOutColor:
    """Colours of the mesh against images, over the pixels that show the mesh; None if none does.

    psnr_db        -10 log10 of the mean squared difference of colours in 0..1, mean over the frames
    l1             mean |difference| of colours in 0..1, mean over the frames
    completeness   ratio of the pixels that show the mesh
    """

    psnr_db: float | None
    l1: float | None
    completeness: float
    frames: int


def held_out_color(mesh: Mesh, camera: Camera, frames: Iterable[tuple[np.ndarray, np.ndarray]]) -> HeldOutColor:
    """Vertex colours of `mesh`, rendered without shading at the poses of `frames`, against their images.

    `frames` yields T_world_camera (4, 4) and color (H, W, 3) uint8. Raises DataError if the mesh has no colours, or
    only the grey of unseen vertices.
    """
    if mesh.colors is None or (mesh.colors == UNSEEN_GREY).all():
        raise DataError("the mesh has no colours")
    surface, vertex_colors = Surface(mesh), mesh.colors.astype(np.float32) / 255
    squared_errors, absolute_errors, ratios = [], [], []
    for T_world_camera, color in frames:
        triangles, weights = surface.triangles(camera, T_world_camera)
        rendered = triangles >= 0
        ratios.append(rendered.mean())
        if not rendered.any():
            continue
        mesh_color = np.einsum("pc,pcx->px", weights[rendered], vertex_colors[mesh.faces[triangles[rendered]]])
        difference = (mesh_color - color[rendered].astype(np.float32) / 255).astype(np.float64)
        squared_errors.append(max(np.square(difference).mean(), MIN_SQUARED_ERROR))
        absolute_errors.append(np.abs(difference).mean())
    return HeldOutColor(
        psnr_db=float(-10 * np.log10(squared_errors).mean()) if squared_errors else None,
        l1=float(np.mean(absolute_errors)) if absolute_errors else None,
        completeness=float(np.mean(ratios)) if ratios else 0.0,
        frames=len(ratios),
    )
