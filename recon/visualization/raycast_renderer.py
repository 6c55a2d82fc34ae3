"""Drawing a mesh with the CPU ray caster, which needs no graphics driver."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core.events import OnEvent, ignore, track_progress
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from .shading import BACKGROUND, SUPERSAMPLING, Geometry, Layer, LitTriangles, average_down, light_triangles
from .views import View

Pictures = dict[str, list[np.ndarray]]  # layer name -> one (H, W, 3) uint8 picture per view


def render(geometry: Geometry, layers: Sequence[Layer], views: Sequence[View], on_event: OnEvent = ignore) -> Pictures:
    """Draw every layer from every view."""
    pictures: Pictures = {layer.name: [] for layer in layers}
    for view in track_progress(views, len(views), "snapshot", on_event, unit="views"):
        lit = light_triangles(geometry, view)
        hits = _cast(geometry.vertices, lit.faces, view)
        for layer in layers:
            pictures[layer.name].append(_fill(lit, layer, *hits))
    return pictures


def _cast(vertices: np.ndarray, faces: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) int64 triangle seen by each subpixel, -1 for none, and (H, W, 3) its barycentric weights."""
    camera = view.camera.resized(view.camera.width * SUPERSAMPLING, view.camera.height * SUPERSAMPLING)
    return Surface(Mesh(vertices, faces)).triangles(camera, view.T_world_camera)


def _fill(lit: LitTriangles, layer: Layer, triangles: np.ndarray, weights: np.ndarray) -> np.ndarray:
    image = np.full((*triangles.shape, 3), BACKGROUND, dtype=np.float32)
    hit = triangles >= 0
    image[hit] = np.einsum("pc,pcx->px", weights[hit], lit.paint(layer)[triangles[hit]])
    return average_down(image)
