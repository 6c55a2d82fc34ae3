"""Triangle meshes and point clouds as values, and their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import DataError
from .events import OnEvent, Warn, ignore
from .mesh_files.reader import read_triangles
from .mesh_files.writer import write_triangles


@dataclass(frozen=True)
class Mesh:
    """vertices (V, 3) float32 metres; faces (F, 3) int32; colors (V, 3) uint8 RGB or None;
    sigma (V,) float32 or None: 1-sigma distance to the true surface in metres (smaller is better)."""

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None = None
    sigma: np.ndarray | None = None

    def save(self, path: Path) -> None:
        """Write PLY (with sigma), OBJ, STL, OFF, glTF or GLB, as the suffix says. Raises RunError."""
        write_triangles(path, self.vertices, self.faces, self.colors, self.sigma)

    @staticmethod
    def load(path: Path, on_event: OnEvent = ignore) -> Mesh:
        """Read a mesh file; polygons become triangles, and what is left out is reported. Raises DataError."""
        surface = load_surface(path, on_event)
        if isinstance(surface, PointCloud):
            raise DataError(
                f"{path} holds no triangles, only {len(surface.points)} points; a point cloud can be nothing but the "
                "ground truth of `uncle eval`"
            )
        return surface


@dataclass(frozen=True)
class PointCloud:
    """points (N, 3) float32 metres, all finite."""

    points: np.ndarray


def load_surface(path: Path, on_event: OnEvent = ignore) -> Mesh | PointCloud:
    """Read a mesh or, from a file without faces, a point cloud. What is left out is reported. Raises DataError."""
    path = Path(path)
    triangles = read_triangles(path)
    for note in triangles.notes:
        on_event(Warn(f"{path}: {note}"))
    if len(triangles.faces) == 0:
        return PointCloud(triangles.vertices)
    return Mesh(triangles.vertices, triangles.faces, triangles.colors, triangles.sigma)
