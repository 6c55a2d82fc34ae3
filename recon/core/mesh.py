"""A triangle mesh as a value, and its PLY file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .errors import DataError
from .files import atomic_path


@dataclass(frozen=True)
class Mesh:
    """vertices (V, 3) float32 metres; faces (F, 3) int32; colors (V, 3) uint8 RGB or None;
    sigma (V,) float32 or None: 1-sigma distance to the true surface in metres (smaller is better)."""

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None = None
    sigma: np.ndarray | None = None

    def save(self, path: Path) -> None:
        """Write a binary PLY: x y z, red green blue, sigma. Raises RunError."""
        fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
        if self.colors is not None:
            fields += [("red", "u1"), ("green", "u1"), ("blue", "u1")]
        if self.sigma is not None:
            fields += [("sigma", "<f4")]
        table = np.zeros(len(self.vertices), dtype=fields)
        for axis, name in enumerate("xyz"):
            table[name] = self.vertices[:, axis]
        if self.colors is not None:
            for channel, name in enumerate(("red", "green", "blue")):
                table[name] = self.colors[:, channel]
        if self.sigma is not None:
            table["sigma"] = self.sigma
        triangles = np.zeros(len(self.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        triangles["count"], triangles["corners"] = 3, self.faces
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            file.write(_ply_header(fields, len(table), len(triangles)).encode())
            file.write(table.tobytes())
            file.write(triangles.tobytes())

    @staticmethod
    def load(path: Path) -> Mesh:
        """Read any mesh file that Open3D reads. Raises DataError if it is missing or has no triangles."""
        import open3d as o3d  # slow to import: only when a mesh is read

        if not Path(path).is_file():
            raise DataError(f"there is no mesh at {path}")
        with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
            legacy = o3d.io.read_triangle_mesh(str(path))
        if not legacy.has_triangles():
            raise DataError(f"{path} holds no triangles: not a mesh, or an empty one")
        colors = (
            np.round(np.asarray(legacy.vertex_colors) * 255).astype(np.uint8) if legacy.has_vertex_colors() else None
        )
        vertices = np.asarray(legacy.vertices, dtype=np.float32)
        return Mesh(
            vertices, np.asarray(legacy.triangles, dtype=np.int32), colors, _read_sigma(Path(path), len(vertices))
        )


def _ply_header(fields: list[tuple[str, str]], vertices: int, faces: int) -> str:
    names = {"<f4": "float", "u1": "uchar"}
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        "comment sigma: 1 sigma in metres",
        f"element vertex {vertices}",
    ]
    lines += [f"property {names[kind]} {name}" for name, kind in fields]
    lines += [f"element face {faces}", "property list uchar int vertex_indices", "end_header"]
    return "\n".join(lines) + "\n"


def _read_sigma(path: Path, vertices: int) -> np.ndarray | None:
    if path.suffix.lower() != ".ply":
        return None
    import open3d as o3d

    attributes = o3d.t.io.read_point_cloud(str(path)).point  # Open3D keeps custom attributes of point clouds only
    if "sigma" not in attributes or len(attributes["sigma"]) != vertices:
        return None
    sigma: np.ndarray = attributes["sigma"].numpy().reshape(-1).astype(np.float32)
    return sigma
