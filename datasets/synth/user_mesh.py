"""A user's own mesh as a scene, with its textures or vertex colours."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d

from ...recon.core.errors import DataError
from ...recon.core.mesh import Mesh
from .scene import Scene

_WHITE = np.full((4, 4, 3), 255, dtype=np.uint8)
_Z_UP_FROM_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_MAX_AREA_DIFFERENCE = 1e-3  # ratio, between two readers of the same file


@dataclass(frozen=True)
class _Part:
    """A triangle mesh, its texture (h, w, 3) uint8 if it has one, and the base colour (3,) of its material."""

    mesh: o3d.geometry.TriangleMesh
    texture: np.ndarray | None
    base_color: np.ndarray


def load_scene(path: Path, up: str = "z") -> Scene:
    """Read a mesh; `up` is "z" or "y" (as in glTF), the result has z up. Raises DataError."""
    path = Path(path)
    mesh = Mesh.load(path)
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        parts = _model_parts(path)
    if not parts:
        return _joined([_plain_part(mesh)], up)
    areas = [_plain_part(mesh).mesh.get_surface_area(), sum(part.mesh.get_surface_area() for part in parts)]
    if abs(areas[0] - areas[1]) > _MAX_AREA_DIFFERENCE * areas[0]:
        raise DataError(
            f"{path}: only {areas[1]:.4g} of {areas[0]:.4g} square metres can be read with their materials; "
            "triangulate the mesh and export it as GLB"
        )
    return _joined(parts, up)


def _model_parts(path: Path) -> list[_Part]:
    """The parts of a file with materials."""
    if path.suffix.lower() in (".ply", ".stl", ".off"):
        return []  # no materials in there
    try:
        model = o3d.io.read_triangle_model(str(path))
    except RuntimeError:
        return []
    parts = []
    for info in model.meshes:
        material = model.materials[info.material_idx] if 0 <= info.material_idx < len(model.materials) else None
        texture: np.ndarray | None = None
        base: np.ndarray = np.ones(3)
        if material is not None:
            base = np.asarray(material.base_color)[:3]
            image = np.asarray(material.albedo_img) if material.albedo_img is not None else np.zeros(0)
            texture = _rgb(image) if image.size else None
        if info.mesh.has_triangles():
            parts.append(_Part(info.mesh, texture, base))
    return parts


def _plain_part(mesh: Mesh) -> _Part:
    """The mesh without materials, in the colours of its vertices."""
    plain = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices.astype(float)), o3d.utility.Vector3iVector(mesh.faces)
    )
    if mesh.colors is not None:
        plain.vertex_colors = o3d.utility.Vector3dVector(mesh.colors / 255)
    return _Part(plain, None, np.ones(3))


def _rgb(image: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 of a grey, RGB or RGBA image of 8 or 16 bits."""
    image = image[..., None] if image.ndim == 2 else image
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    return np.ascontiguousarray(image[..., :3] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2))


def _joined(parts: list[_Part], up: str) -> Scene:
    vertices, faces, uvs, texture_ids, tints, textures = [], [], [], [], [], [_WHITE]
    count = 0
    for part in parts:
        mesh, texture = part.mesh, part.texture
        triangles = np.asarray(mesh.triangles)
        uv = np.zeros((len(triangles), 3, 2))
        texture_id = 0
        if texture is not None and mesh.has_triangle_uvs():
            # Open3D counts v from the bottom of the image
            uv = np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2) * [1, -1] + [0, 1]
            texture_id = len(textures)
            textures.append(texture)
        tint = np.broadcast_to(part.base_color, (len(triangles), 3, 3))
        if mesh.has_vertex_colors():
            tint = tint * np.asarray(mesh.vertex_colors)[triangles] ** 2  # the square stands for the sRGB curve
        vertices.append(np.asarray(mesh.vertices))
        faces.append(triangles + count)
        uvs.append(uv)
        tints.append(tint)
        texture_ids.append(np.full(len(triangles), texture_id))
        count += len(mesh.vertices)
    points = np.concatenate(vertices)
    return Scene(
        (points @ _Z_UP_FROM_Y_UP.T if up == "y" else points).astype(np.float32),
        np.concatenate(faces).astype(np.int32),
        np.concatenate(uvs).astype(np.float32),
        np.concatenate(texture_ids).astype(np.int16),
        tuple(textures),
        np.concatenate(tints).astype(np.float32),
    )
