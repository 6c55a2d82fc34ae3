"""The part of a scene that the cameras saw, as a mesh of small triangles: the ground truth of a recording."""

from __future__ import annotations

import numpy as np
import open3d as o3d

from ...recon.core.camera import Camera
from ...recon.core.mesh import Mesh
from .render import Renderer
from .scene import Scene

EDGE_M = 0.05
_MAX_TRIANGLES = 3_000_000


class SeenSurface:
    """Marks small triangles of a scene whose centre some camera saw."""

    def __init__(self, renderer: Renderer) -> None:
        self._renderer = renderer
        scene = renderer.scene
        corners = scene.vertices[scene.faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = float(np.linalg.norm(cross, axis=1).sum() / 2)
        self.edge_m = max(EDGE_M, float(np.sqrt(4 * area / _MAX_TRIANGLES)))
        self.faces, self.barycentric = subdivide(scene, self.edge_m)
        self._centers = np.einsum("tc,tcx->tx", self.barycentric.mean(axis=1), corners[self.faces])
        self.seen = np.zeros(len(self.faces), dtype=bool)
        self._left = np.arange(len(self.faces))  # not seen yet, and their centres

    def add(self, T_world_camera: np.ndarray, camera: Camera) -> None:
        """Mark what a camera at a pose (4, 4) sees."""
        origin = T_world_camera[:3, 3].astype(np.float32)
        x, y, z = T_world_camera[:3, :3].T.astype(np.float32) @ (self._centers - origin).T
        u, v = camera.fx * x + camera.cx * z, camera.fy * y + camera.cy * z  # times depth
        inside = (z > 0.01) & (u >= 0) & (v >= 0) & (u <= (camera.width - 1) * z) & (v <= (camera.height - 1) * z)
        candidates = np.flatnonzero(inside)
        offset = self._centers[candidates] - origin
        rays = np.concatenate([np.broadcast_to(origin, offset.shape), offset], axis=1)
        hidden = self._renderer.raycaster.test_occlusions(o3d.core.Tensor(rays), tnear=0.0, tfar=1.0 - 1e-3).numpy()
        found = candidates[~hidden]
        self.seen[self._left[found]] = True
        keep = np.ones(len(self._left), dtype=bool)
        keep[found] = False
        self._left, self._centers = self._left[keep], self._centers[keep]

    def mesh(self) -> Mesh:
        """The seen triangles with the colours of the scene's textures at their corners, without light and shade."""
        scene = self._renderer.scene
        faces, barycentric = self.faces[self.seen], self.barycentric[self.seen]
        corners = np.einsum("tkc,tcx->tkx", barycentric, scene.vertices[scene.faces[faces]]).reshape(-1, 3)
        owner, weights = np.repeat(faces, 3), barycentric.reshape(-1, 3)
        keys = np.column_stack([np.rint(corners * 1e4).astype(np.int64), scene.texture_ids[owner]])
        _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        footprint = np.full(len(first), self.edge_m / 2)
        linear = self._renderer.albedo(owner[first], weights[first, 1:], footprint)
        colors = np.clip(255 * np.sqrt(linear) + 0.5, 0, 255).astype(np.uint8)
        return Mesh(corners[first].astype(np.float32), index.reshape(-1, 3).astype(np.int32), colors)


def subdivide(scene: Scene, edge_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Halve the longest edges until none exceeds `edge_m`.

    Returns, for T small triangles, the face of the scene each is a part of, (T,), and the barycentric coordinates of
    its corners in that face, (T, 3, 3). Their union is the scene's surface, exactly.
    """
    faces = np.arange(len(scene.faces))
    barycentric = np.broadcast_to(np.eye(3, dtype=np.float32), (len(faces), 3, 3)).copy()
    done_faces, done_barycentric = [], []
    while len(faces):
        corners = np.einsum("tkc,tcx->tkx", barycentric, scene.vertices[scene.faces[faces]])
        lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)  # edge k joins corners k and k + 1
        longest = lengths.argmax(axis=1)
        small = lengths.max(axis=1) <= edge_m
        done_faces.append(faces[small])
        done_barycentric.append(barycentric[small])
        faces, barycentric, longest = faces[~small], barycentric[~small], longest[~small]
        rows = np.arange(len(faces))
        a, b, c = (barycentric[rows, (longest + k) % 3] for k in range(3))
        middle = (a + b) / 2
        barycentric = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
        faces = np.concatenate([faces, faces])
    return np.concatenate(done_faces), np.concatenate(done_barycentric)
