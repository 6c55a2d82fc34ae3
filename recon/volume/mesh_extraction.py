"""From a map to a mesh: the surface that the cameras saw, with colour and sigma at each vertex."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..core.camera import Camera
from ..core.errors import DataError
from ..core.events import OnEvent, ignore, track_progress
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from .marching_cubes import extract_isosurface
from .neural_field import ACTIVE_VOXELS, NeuralField
from .sparse_grid import ROWS, SparseGrid

MIN_COMPONENT_M2 = 0.02  # a loose piece smaller than this is a floater
MAX_VIEWS = 150  # cameras asked what they see; more add nothing but time
VISIBLE_VOXELS = 1.0  # a vertex this far behind the first surface on its ray is still part of it
_VERTICES_AT_A_TIME = 1 << 17


def make_mesh(
    field: NeuralField,
    camera: Camera,
    T_world_camera: Sequence[np.ndarray],
    voxel_size_m: float | None = None,
    clean: bool = True,
    max_sigma_m: float | None = None,
    on_event: OnEvent = ignore,
) -> Mesh:
    """Iso-surface of `field` at `voxel_size_m` (default: its own).

    clean          keep only what some camera of `T_world_camera` saw, without floaters
    max_sigma_m    leave out vertices whose sigma (metres) is worse
    Raises DataError if nothing is left.
    """
    grid, samples = _sampled(field, voxel_size_m)
    vertices, faces = extract_isosurface(grid, samples, on_event)
    if clean and len(faces):
        tolerance = VISIBLE_VOXELS * field.grid.voxel_size_m
        seen = seen_vertices(Mesh(vertices, faces), camera, T_world_camera, tolerance, on_event)
        vertices, faces = _keep(vertices, faces, seen)
        vertices, faces = _keep(vertices, faces, ~_floaters(vertices, faces))
    colors, sigma = _attributes(field, vertices)
    if max_sigma_m is not None and len(faces):
        trusted = sigma <= max_sigma_m
        if not trusted[faces].all(1).any():
            raise DataError(
                f"no part of the surface is as sure as {max_sigma_m * 100:g} cm: half of its vertices are surer than "
                f"{np.median(sigma) * 100:.2f} cm; give a larger --max-sigma"
            )
        vertices, faces, colors, sigma = _keep(vertices, faces, trusted, colors, sigma)
    if not len(faces):
        raise DataError(
            "the map has no surface: too few readings agree; map more frames, or lower --set fusion.min_observations"
        )
    return Mesh(vertices, faces, colors, sigma)


def seen_vertices(
    mesh: Mesh, camera: Camera, T_world_camera: Sequence[np.ndarray], tolerance_m: float, on_event: OnEvent = ignore
) -> np.ndarray:
    """(V,) bool: vertices that are the first surface (within `tolerance_m`) on the ray of some pixel of some camera."""
    surface = Surface(mesh)
    seen = np.zeros(len(mesh.vertices), dtype=bool)
    small = camera.resized(camera.width // 2, camera.height // 2)
    chosen = np.unique(np.linspace(0, len(T_world_camera) - 1, min(MAX_VIEWS, len(T_world_camera))).astype(int))
    for view in track_progress(chosen, len(chosen), "keeping what was seen", on_event, "views"):
        T = T_world_camera[view]
        rows = np.flatnonzero(~seen)
        local = (mesh.vertices[rows] - T[:3, 3].astype(np.float32)) @ T[:3, :3].astype(np.float32)
        u, v, z = (values.numpy() for values in small.project(torch.from_numpy(local)))
        u, v = np.round(u), np.round(v)
        inside = (u >= 0) & (u < small.width) & (v >= 0) & (v < small.height)
        first = surface.depth(small, T)
        shown = first[v[inside].astype(int), u[inside].astype(int)]
        slack = tolerance_m + 2 * z[inside] / small.fx  # a slanted surface changes depth within a pixel
        likely = rows[inside][(z[inside] < shown + slack) & np.isfinite(shown) & (shown > 0)]
        seen[likely] = _in_sight(surface, T[:3, 3], mesh.vertices[likely], tolerance_m)
    return seen


def _in_sight(surface: Surface, centre: np.ndarray, points: np.ndarray, tolerance_m: float) -> np.ndarray:
    """(N,) bool: nothing lies more than `tolerance_m` before the points (N, 3) as seen from `centre` (3,)."""
    ways = points - centre.astype(points.dtype)
    lengths = np.linalg.norm(ways, axis=1)
    hit = surface.cast(centre, ways) * lengths
    return (hit == 0) | (hit > lengths - tolerance_m)  # no hit: the ray slipped past the border at the point itself


def _sampled(field: NeuralField, voxel_size_m: float | None):
    """The grid to extract from and its samples: the field's own, or one of another voxel size over the same surface."""
    own = field.grid.voxel_size_m
    if voxel_size_m is None or abs(voxel_size_m - own) < 1e-9:
        return field.grid, field.samples
    grid = SparseGrid(voxel_size_m, field.grid.device)
    near = (field.known & (field.base[:, 0].abs() < ACTIVE_VOXELS * own)).nonzero()[:, 0]
    inner = field.grid.inner_offsets()
    for part in near.split(_VERTICES_AT_A_TIME):
        points = field.grid.blocks[part // ROWS] * field.grid.block_size_m + inner[part % ROWS]
        ends = torch.cat([points - own, points + own])
        grid.allocate(torch.floor(ends / grid.block_size_m).long())

    def samples(ids: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        points = grid.block_positions(ids).view(-1, 3)
        parts = []
        with torch.no_grad():
            for part in points.split(_VERTICES_AT_A_TIME):
                sdf, _, known = field(part)
                parts.append((sdf, known))
        sdf = torch.cat([part[0] for part in parts]) if parts else points[:, 0]
        known = torch.cat([part[1] for part in parts]) if parts else points[:, 0] > 0
        return sdf.view(-1, ROWS), known.view(-1, ROWS)

    return grid, samples


def _keep(vertices: np.ndarray, faces: np.ndarray, keep: np.ndarray, *attributes: np.ndarray):
    """Drop vertices (V,) marked False and the faces that use one."""
    faces = faces[keep[faces].all(1)]
    used = np.unique(faces)
    index = np.zeros(len(vertices), np.int32)
    index[used] = np.arange(len(used), dtype=np.int32)
    return (vertices[used], index[faces], *(values[used] for values in attributes))


def _floaters(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) bool: vertices of connected pieces smaller than `MIN_COMPONENT_M2`."""
    if not len(faces):
        return np.zeros(len(vertices), dtype=bool)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(edges), bool), edges.T), shape=(len(vertices),) * 2)
    count, label = connected_components(graph, directed=False)
    return np.bincount(label[faces[:, 0]], weights=area, minlength=count)[label] < MIN_COMPONENT_M2


@torch.no_grad()
def _attributes(field: NeuralField, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Colours (V, 3) uint8 and sigma (V,) float32 metres."""
    colors, sigmas = [np.zeros((0, 3), np.uint8)], [np.zeros(0, np.float32)]
    for part in torch.from_numpy(vertices).to(field.grid.device).split(_VERTICES_AT_A_TIME):
        _, rgb, _ = field(part)
        rows, weights = field.grid.trilinear(part)
        weights = weights * (rows >= 0)
        sigma = (field.sigma[rows.clamp(min=0)] * weights).sum(1) / weights.sum(1).clamp(min=1e-6)
        colors.append((rgb.clamp(0, 1) * 255).round().byte().cpu().numpy())
        sigmas.append(sigma.cpu().numpy())
    return np.concatenate(colors), np.concatenate(sigmas).astype(np.float32)
