"""Questions to a surface: distance to it, rays against it, samples of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from .camera import Camera
from .errors import DataError
from .mesh import Mesh, PointCloud

if TYPE_CHECKING:
    import open3d as o3d


class Surface:
    """A mesh prepared for ray casting. An empty mesh is infinitely far from everything and hit by no ray."""

    def __init__(self, mesh: Mesh) -> None:
        import open3d as o3d  # slow to import: only when a mesh is questioned

        self._scene = o3d.t.geometry.RaycastingScene()
        self._is_empty = len(mesh.faces) == 0
        if not self._is_empty:
            self._scene.add_triangles(
                np.ascontiguousarray(mesh.vertices, dtype=np.float32),
                np.ascontiguousarray(mesh.faces, dtype=np.uint32),
            )

    def distance(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) points, metres -> (N,) float32 unsigned distance to the nearest point of the surface, metres."""
        if self._is_empty or len(points) == 0:
            return np.full(len(points), np.inf, dtype=np.float32)
        distances: np.ndarray = self._scene.compute_distance(np.ascontiguousarray(points, dtype=np.float32)).numpy()
        return distances

    def cast(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(..., 3) origins and directions -> (...) float32 ray parameter of the first hit, 0 where there is none.

        Both sides of a triangle count.
        """
        if self._is_empty:
            return np.zeros(directions.shape[:-1], dtype=np.float32)
        hit = self._first_hits(origins, directions)["t_hit"].numpy()
        depths: np.ndarray = np.where(np.isfinite(hit), hit, 0.0).astype(np.float32)
        return depths

    def triangles(self, camera: Camera, T_world_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(H, W) int64 triangle that each pixel sees from `T_world_camera` (4, 4), -1 where none is, and the (H, W, 3)
        barycentric weights of its corners there."""
        directions = camera.rays().numpy() @ T_world_camera[:3, :3].T.astype(np.float32)
        if self._is_empty:
            return np.full(directions.shape[:2], -1), np.zeros_like(directions)
        answer = self._first_hits(T_world_camera[:3, 3], directions)
        hit, uv = np.isfinite(answer["t_hit"].numpy()), answer["primitive_uvs"].numpy()
        weights = np.stack([1 - uv[..., 0] - uv[..., 1], uv[..., 0], uv[..., 1]], axis=-1)
        return np.where(hit, answer["primitive_ids"].numpy().astype(np.int64), -1), weights

    def hit_normals(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(R, 3) or (3,) origins and (R, 3) directions -> (R,) bool whether a ray hits, and the (R, 3) unit normal of
        the first triangle that it hits (by the order of its corners)."""
        if self._is_empty:
            return np.zeros(len(directions), dtype=bool), np.zeros_like(directions)
        answer = self._first_hits(origins, directions)
        return np.isfinite(answer["t_hit"].numpy()), answer["primitive_normals"].numpy()

    def depth(self, camera: Camera, T_world_camera: np.ndarray) -> np.ndarray:
        """(H, W) float32 z-depth in metres seen from `T_world_camera` (4, 4), 0 where no surface is."""
        directions = camera.rays().numpy() @ T_world_camera[:3, :3].T
        return self.cast(T_world_camera[:3, 3], directions)

    def _first_hits(self, origins: np.ndarray, directions: np.ndarray) -> dict[str, o3d.core.Tensor]:
        """Open3D's answer to the rays (..., 3), of a mesh that is not empty."""
        rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=-1).astype(np.float32)
        answer: dict[str, o3d.core.Tensor] = self._scene.cast_rays(rays)
        return answer


def distance_to(surface: Mesh | PointCloud) -> Callable[[np.ndarray], np.ndarray]:
    """The function (N, 3) points -> (N,) distance to the triangles of a mesh, or to the nearest point of a cloud, m."""
    if isinstance(surface, Mesh):
        return Surface(surface).distance
    tree = cKDTree(surface.points)
    return lambda points: np.asarray(tree.query(points)[0], dtype=np.float32)


def sample_points(surface: Mesh | PointCloud, count: int, rng: np.random.Generator) -> np.ndarray:
    """(N, 3) float64: `count` samples of a mesh (`sample_surface`), or the points of a cloud, `count` at most."""
    if isinstance(surface, Mesh):
        return sample_surface(surface, count, rng)
    points = surface.points.astype(np.float64)
    return points if len(points) <= count else points[rng.choice(len(points), count, replace=False)]


def sample_surface(mesh: Mesh, count: int, rng: np.random.Generator) -> np.ndarray:
    """(count, 3) float64 points, uniform over the area; (0, 3) if the mesh has no area.

    Points of a triangle by the square-root parametrisation (Turk 1990). Raises DataError if a vertex is not finite.
    """
    if not np.isfinite(mesh.vertices).all():
        broken = int((~np.isfinite(mesh.vertices).all(axis=1)).sum())
        raise DataError(f"{broken} of {len(mesh.vertices)} vertices of the mesh are not finite; remove them first")
    corners = mesh.vertices.astype(np.float64)[mesh.faces]
    edge_a, edge_b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.linalg.norm(np.cross(edge_a, edge_b), axis=1)
    if area.sum() <= 0.0:
        return np.zeros((0, 3))
    cumulative = np.cumsum(area)
    chosen = np.searchsorted(cumulative, rng.random(count) * cumulative[-1], side="right")
    chosen = np.minimum(chosen, len(area) - 1)
    root, along = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    samples: np.ndarray = corners[chosen, 0] + root * (1.0 - along) * edge_a[chosen] + root * along * edge_b[chosen]
    return samples
