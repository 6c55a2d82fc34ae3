"""A user's own mesh as a scene, with its textures or vertex colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d as o3d

from ...recon.core.errors import DataError
from .scene import Scene

_WHITE = np.full((4, 4, 3), 255, dtype=np.uint8)
_Z_UP_FROM_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
_ADVICE = "give a GLB, glTF, OBJ or PLY file of triangles, in metres"


def load_scene(path: Path, up: str = "z") -> Scene:
    """Read a mesh; `up` is "z" or "y" (as in glTF), the result has z up. Raises DataError."""
    path = Path(path)
    if not path.is_file():
        raise DataError(f"there is no mesh at {path}")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        parts = _model_parts(path) or _plain_parts(path)
    if not parts:
        raise DataError(f"{path} holds no triangles: not a mesh, or an empty one; {_ADVICE}")
    scene = _joined(parts, up)
    if not np.isfinite(scene.vertices).all():
        raise DataError(f"{path} has vertices that are not finite; repair the mesh first")
    return scene


def _model_parts(path: Path) -> list[tuple]:
    """(mesh, texture or None, base colour (3,)) of each part of a file with materials."""
    if path.suffix.lower() in (".ply", ".stl", ".off"):
        return []  # no materials in there
    try:
        model = o3d.io.read_triangle_model(str(path))
    except RuntimeError:
        return []
    parts = []
    for info in model.meshes:
        material = model.materials[info.material_idx] if 0 <= info.material_idx < len(model.materials) else None
        texture, base = None, np.ones(3)
        if material is not None:
            base = np.asarray(material.base_color)[:3]
            image = np.asarray(material.albedo_img) if material.albedo_img is not None else np.zeros(0)
            texture = _rgb(image) if image.size else None
        if info.mesh.has_triangles():
            parts.append((info.mesh, texture, base))
    return parts


def _plain_parts(path: Path) -> list[tuple]:
    mesh = o3d.io.read_triangle_mesh(str(path))
    return [(mesh, None, np.ones(3))] if mesh.has_triangles() else []


def _rgb(image: np.ndarray) -> np.ndarray:
    """(h, w, 3) uint8 of a grey, RGB or RGBA image of 8 or 16 bits."""
    image = image[..., None] if image.ndim == 2 else image
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    return np.ascontiguousarray(image[..., :3] if image.shape[2] >= 3 else np.repeat(image[..., :1], 3, axis=2))


def _joined(parts: list[tuple], up: str) -> Scene:
    vertices, faces, uvs, texture_ids, tints, textures = [], [], [], [], [], [_WHITE]
    count = 0
    for mesh, texture, base in parts:
        triangles = np.asarray(mesh.triangles)
        has_uvs = texture is not None and mesh.has_triangle_uvs()
        uv = np.asarray(mesh.triangle_uvs).reshape(-1, 3, 2) if has_uvs else np.zeros((len(triangles), 3, 2))
        if has_uvs:
            textures.append(texture)
            uv = uv * [1, -1] + [0, 1]  # Open3D counts v from the bottom of the image
        tint = np.broadcast_to(base, (len(triangles), 3, 3))
        if mesh.has_vertex_colors():
            tint = tint * np.asarray(mesh.vertex_colors)[triangles] ** 2  # the square stands for the sRGB curve
        vertices.append(np.asarray(mesh.vertices))
        faces.append(triangles + count)
        uvs.append(uv)
        tints.append(tint)
        texture_ids.append(np.full(len(triangles), len(textures) - 1 if has_uvs else 0))
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
