"""Shading of triangles by the position of the viewer: the part of drawing that both renderers share.

Light is baked into corner colours, so that a renderer only has to fill triangles and both give the same picture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .views import View

SUPERSAMPLING = 2  # pictures are drawn this many times larger and averaged down
BACKGROUND = 255
_CREASE = np.cos(np.radians(40.0))  # edges sharper than this are not smoothed
_SIDE_LIGHT = np.array([-0.06, -0.14, 0.0])  # camera axes: from the left and above, so that walls differ
_AMBIENT, _DARKEST = 0.36, 0.22
_SIDE_THICKNESS_RATIO = 0.12  # triangles this close to a side of the bounding box, relative to its size, belong to it


@dataclass(frozen=True)
class Layer:
    """Vertex colours of a mesh: colors (V, 3) uint8; `contrast` 0..1 is the strength of the shading."""

    name: str
    colors: np.ndarray
    contrast: float


@dataclass(frozen=True)
class Geometry:
    """Triangles ready for drawing: vertices (V, 3), faces (F, 3), normals of faces (F, 3) and of corners (F, 3, 3)."""

    vertices: np.ndarray
    faces: np.ndarray
    face_normals: np.ndarray
    corner_normals: np.ndarray

    @staticmethod
    def build(vertices: np.ndarray, faces: np.ndarray) -> Geometry:
        """Normals from vertices (V, 3) and faces (F, 3): smooth where the surface is, sharp at creases."""
        corners = vertices[faces].astype(np.float32)
        area_normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        face_normals = _unit(area_normals)
        vertex_normals = np.stack(
            [
                np.bincount(faces.ravel(), weights=np.repeat(area_normals[:, axis], 3), minlength=len(vertices))
                for axis in range(3)
            ],
            axis=1,
        )
        smooth = _unit(vertex_normals.astype(np.float32))[faces]
        agree = np.einsum("fcx,fx->fc", smooth, face_normals) > _CREASE
        return Geometry(vertices, faces, face_normals, np.where(agree[..., None], smooth, face_normals[:, None]))


@dataclass(frozen=True)
class LitTriangles:
    """The triangles of one view: faces (K, 3) turned to the viewer, light (K, 3) per corner, 1 = fully lit."""

    faces: np.ndarray
    light: np.ndarray

    def paint(self, layer: Layer) -> np.ndarray:
        """(K, 3, 3) float32 RGB 0..255 of the corners."""
        light = 1.0 - layer.contrast * (1.0 - self.light)
        return layer.colors[self.faces].astype(np.float32) * light[..., None]


def light_triangles(geometry: Geometry, view: View) -> LitTriangles:
    """Triangles that `view` does not cut away, oriented to the viewer and lit from the camera."""
    eye = view.T_world_camera[:3, 3].astype(np.float32)
    front = np.einsum("fx,fx->f", geometry.face_normals, geometry.vertices[geometry.faces[:, 0]] - eye) < 0
    if view.cut == "back":
        shown = front
    elif view.cut == "front":
        shown = ~front
    elif view.cut == "near_sides":
        shown = ~_on_near_sides(geometry, eye)
    else:
        shown = np.ones(len(front), dtype=bool)
    faces, normals, turn = geometry.faces[shown], geometry.corner_normals[shown], ~front[shown]
    faces = np.where(turn[:, None], faces[:, ::-1], faces)
    normals = np.where(turn[:, None, None], -normals[:, ::-1], normals)
    in_camera = normals @ view.T_world_camera[:3, :3].astype(np.float32)
    light = _AMBIENT + (1 - _AMBIENT) * np.clip(-in_camera[..., 2], 0, 1) + in_camera @ _SIDE_LIGHT.astype(np.float32)
    return LitTriangles(faces, np.clip(light, _DARKEST, 1.0))


def _on_near_sides(geometry: Geometry, eye: np.ndarray) -> np.ndarray:
    """(F,) bool: triangles along those sides of the bounding box that have the viewer on their outside."""
    corners = geometry.vertices[geometry.faces]
    low, high = geometry.vertices.min(0), geometry.vertices.max(0)
    margin = _SIDE_THICKNESS_RATIO * (high - low)
    near_low = (corners < low + margin).all(1) & (eye < low)
    near_high = (corners > high - margin).all(1) & (eye > high)
    return (near_low | near_high).any(1)


def average_down(image: np.ndarray) -> np.ndarray:
    """(S*H, S*W, 3) supersampled values -> (H, W, 3) uint8."""
    height, width = image.shape[0] // SUPERSAMPLING, image.shape[1] // SUPERSAMPLING
    blocks = image.reshape(height, SUPERSAMPLING, width, SUPERSAMPLING, 3).astype(np.float32)
    return np.clip(blocks.mean((1, 3)) + 0.5, 0, 255).astype(np.uint8)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-20)
