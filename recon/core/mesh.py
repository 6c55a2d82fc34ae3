"""Triangle meshes and point clouds as values, and their files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import DataError
from .events import OnEvent, Warn, ignore
from .mesh_files.reader import read_triangles
from .mesh_files.writer import write_triangles
from .world_offset import NO_OFFSET, Offset


@dataclass(frozen=True)
class Mesh:
    """vertices (V, 3) float32 metres, relative to offset_m; faces (F, 3) int32; colors (V, 3) uint8 RGB or None;
    sigma (V,) float32 or None: 1-sigma distance to the true surface in metres (smaller is better);
    offset_m (3,): their origin in the world of the file, far from the world's own (`world_offset.py`)."""

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None = None
    sigma: np.ndarray | None = None
    offset_m: Offset = NO_OFFSET

    def save(self, path: Path) -> None:
        """Write PLY (with sigma), OBJ, STL, OFF, glTF or GLB, as the suffix says, in the world. Raises RunError."""
        write_triangles(path, self.vertices, self.faces, self.colors, self.sigma, self.offset_m)

    @staticmethod
    def load(path: Path, on_event: OnEvent = ignore, offset_m: Offset | None = None) -> Mesh:
        """Read a mesh file; polygons become triangles, and what is left out is reported.

        offset_m   what the vertices are to be relative to; None: chosen where they are far from the origin

        Raises DataError.
        """
        surface = load_surface(path, on_event, offset_m)
        if isinstance(surface, PointCloud):
            raise DataError(
                f"{path} holds no triangles, only {len(surface.points)} points; a point cloud can be nothing but the "
                "ground truth of `uncle eval`"
            )
        return surface


@dataclass(frozen=True)
class PointCloud:
    """points (N, 3) float32 metres, all finite, relative to offset_m as in `Mesh`."""

    points: np.ndarray
    offset_m: Offset = NO_OFFSET


def load_surface(path: Path, on_event: OnEvent = ignore, offset_m: Offset | None = None) -> Mesh | PointCloud:
    """Read a mesh or, from a file without faces, a point cloud. What is left out is reported. Raises DataError."""
    path = Path(path)
    triangles = read_triangles(path, offset_m)
    for note in triangles.notes:
        on_event(Warn(f"{path}: {note}"))
    if len(triangles.faces) == 0:
        return PointCloud(triangles.vertices, triangles.offset_m)
    return Mesh(triangles.vertices, triangles.faces, triangles.colors, triangles.sigma, triangles.offset_m)
