"""The true signed distance in a box around a recording, from its reference mesh and from where its cameras looked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import binary_dilation

from ...core.camera import Camera
from ...core.events import OnEvent, ignore, track_progress
from ...core.mesh import Mesh

if TYPE_CHECKING:
    import open3d as o3d

_STEPS = 127.0  # the largest distance as a signed byte
_SURE_M = 0.1  # before or behind the true depth of a pixel by more: no ray is needed to tell
_SLOPE = 0.05  # of that depth: what a slanted surface changes within a pixel
_ROWS_AT_A_TIME = 1 << 20


@dataclass(frozen=True)
class TrueDistance:
    """steps (X, Y, Z) int8: distance in 127ths of `truncation_m`, positive where a camera saw through.

    Sample (i, j, k) lies at `voxel_size_m` * (first + (i, j, k)), world, metres.
    """

    steps: np.ndarray
    first: np.ndarray
    voxel_size_m: float
    truncation_m: float

    @staticmethod
    def measure(
        mesh: Mesh, camera: Camera, T_world_camera: np.ndarray, true_depth: np.ndarray, voxel_size_m: float,
        truncation_voxels: int, on_event: OnEvent = ignore,
    ) -> TrueDistance:  # fmt: skip
        """Distances to `mesh`; the sign is that of visibility, because a room is no closed solid.

        A sample is in front (positive) if one of the cameras (N, 4, 4) saw it: by the true depth (N, H, W) metres of
        its pixel where that is far from it, else by a ray cast to it. All others are behind. A measurement that lies
        where no camera ever looked is wrong, so hidden free space may count as behind.
        """
        truncation = truncation_voxels * voxel_size_m
        margin = truncation_voxels + 4
        first = np.floor(mesh.vertices.min(0) / voxel_size_m).astype(np.int64) - margin
        shape = np.ceil(mesh.vertices.max(0) / voxel_size_m).astype(np.int64) + margin + 1 - first
        near = _near(mesh, first, shape, voxel_size_m, truncation)
        positions = ((np.argwhere(np.ones(shape, bool)) + first) * voxel_size_m).astype(np.float32)
        free = _seen(positions, near.ravel(), mesh, camera, T_world_camera, true_depth, on_event)
        steps = np.where(free, _STEPS, -_STEPS)
        rows = np.flatnonzero(near.ravel())
        distance = np.minimum(_distance(mesh, positions[rows]) / truncation, 1) * _STEPS
        steps[rows] = np.where(free[rows], distance, -distance)
        return TrueDistance(np.rint(steps).astype(np.int8).reshape(shape), first, voxel_size_m, truncation)

    def arrays(self) -> dict[str, Any]:
        """For `from_arrays`."""
        return {"steps": self.steps, "first": self.first, "sizes": np.array([self.voxel_size_m, self.truncation_m])}

    @staticmethod
    def from_arrays(arrays: dict[str, np.ndarray], key: str) -> TrueDistance:
        """Of arrays whose names begin with `key`. Raises KeyError, ValueError."""
        voxel, truncation = arrays[key + "sizes"].astype(float).tolist()
        steps, first = arrays[key + "steps"], arrays[key + "first"]
        if steps.ndim != 3 or steps.dtype != np.int8 or first.shape != (3,) or not (voxel > 0 and truncation > 0):
            raise ValueError("its distances are no grid")
        return TrueDistance(steps, first, voxel, truncation)


def _near(mesh: Mesh, first: np.ndarray, shape: np.ndarray, voxel_size_m: float, truncation_m: float) -> np.ndarray:
    """(X, Y, Z) bool: samples that may lie within the truncation of the mesh."""
    corners = mesh.vertices[mesh.faces]
    longest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1).max())
    parts = max(1, int(np.ceil(longest / (2 * voxel_size_m))))
    marked = np.zeros(shape, bool)
    for a in range(parts + 1):
        for b in range(parts + 1 - a):
            point = (corners * (np.array([a, b, parts - a - b]) / parts)[None, :, None]).sum(1)
            marked[tuple((np.rint(point / voxel_size_m).astype(np.int64) - first).T)] = True
    return binary_dilation(marked, np.ones((3, 3, 3), bool), iterations=int(np.ceil(truncation_m / voxel_size_m)) + 2)


def _seen(
    positions: np.ndarray, near: np.ndarray, mesh: Mesh, camera: Camera, T_world_camera: np.ndarray,
    true_depth: np.ndarray, on_event: OnEvent,
) -> np.ndarray:  # fmt: skip
    """(P,) bool: samples that a camera saw."""
    import open3d as o3d

    caster = _caster(mesh)
    free = np.zeros(len(positions), bool)
    views = list(zip(T_world_camera, true_depth, strict=True))
    for T, depth in track_progress(views, len(views), "true distances", on_event, "views"):
        left = np.flatnonzero(~free)
        x, y, z = ((positions[left] - T[:3, 3].astype(np.float32)) @ T[:3, :3].astype(np.float32)).T
        safe = np.maximum(z, 1e-3)
        u = np.rint(camera.fx * x / safe + camera.cx).astype(np.int64)
        v = np.rint(camera.fy * y / safe + camera.cy).astype(np.int64)
        inside = (z > 1e-3) & (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
        left, z = left[inside], z[inside]
        shown = depth[v[inside], u[inside]]
        slack = _SURE_M + _SLOPE * shown
        free[left[(shown == 0) | (z < shown - slack)]] = True  # no depth: the view goes on for ever
        unsure = left[(shown > 0) & (np.abs(z - shown) <= slack) & near[left]]
        if len(unsure):
            ways = positions[unsure] - T[:3, 3].astype(np.float32)
            rays = np.concatenate([np.broadcast_to(T[:3, 3].astype(np.float32), ways.shape), ways], 1)
            hidden = caster.test_occlusions(o3d.core.Tensor(rays), tnear=0.0, tfar=1.0).numpy()
            free[unsure[~hidden]] = True
    return free


def _distance(mesh: Mesh, points: np.ndarray) -> np.ndarray:
    """(P,) metres to the mesh, without sign."""
    import open3d as o3d

    caster = _caster(mesh)
    parts = np.array_split(points, max(1, len(points) // _ROWS_AT_A_TIME))
    return np.concatenate([caster.compute_distance(o3d.core.Tensor(part)).numpy() for part in parts])


def _caster(mesh: Mesh) -> o3d.t.geometry.RaycastingScene:
    import open3d as o3d

    caster = o3d.t.geometry.RaycastingScene()
    caster.add_triangles(o3d.core.Tensor(mesh.vertices), o3d.core.Tensor(mesh.faces.astype(np.uint32)))
    return caster
