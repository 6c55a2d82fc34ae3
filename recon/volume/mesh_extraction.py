"""Mesh of a map: the surface that the cameras saw, with colour and sigma at each vertex."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from ..core.camera import Camera
from ..core.errors import DataError
from ..core.events import OnEvent, ignore, track_progress
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from .marching_cubes import BlockSamples, extract_isosurface
from .neural_field import ACTIVE_VOXELS, NeuralField
from .sparse_grid import ROWS, SparseGrid

_VERTICES_AT_A_TIME = 1 << 17


@dataclass(frozen=True)
class MeshExtractionParameters:
    """Constants of the cleaning.

    min_component_m2   connected pieces with a smaller area are removed
    max_views          cameras that visibility is tested from, spread evenly over all
    tolerance_voxels   a vertex this far behind the first surface on its ray counts as visible
    max_slope          depth may change by this many metres per metre across a pixel: slack of a first, coarse test
    """

    min_component_m2: float = 0.02
    max_views: int = 150
    tolerance_voxels: float = 1.0
    max_slope: float = 2.0


PARAMETERS = MeshExtractionParameters()


def make_mesh(
    field: NeuralField,
    camera: Camera,
    T_world_camera: Sequence[np.ndarray],
    voxel_size_m: float | None = None,
    clean: bool = True,
    max_sigma_m: float | None = None,
    on_event: OnEvent = ignore,
    parameters: MeshExtractionParameters = PARAMETERS,
) -> Mesh:
    """Iso-surface of `field` at `voxel_size_m` (default: its own).

    clean          keep only what is visible from some pose of `T_world_camera`, without small loose pieces
    max_sigma_m    leave out vertices with a larger sigma, metres
    Raises DataError if nothing is left.
    """
    grid, samples = _grid_at(field, voxel_size_m)
    vertices, faces = extract_isosurface(grid, samples, on_event)
    if clean and len(faces):
        tolerance_m = parameters.tolerance_voxels * field.grid.voxel_size_m
        visible = visible_vertices(Mesh(vertices, faces), camera, T_world_camera, tolerance_m, on_event, parameters)
        vertices, faces = _select(vertices, faces, visible)
        vertices, faces = _select(vertices, faces, ~_in_small_component(vertices, faces, parameters.min_component_m2))
    colors, sigma = _attributes(field, vertices)
    if max_sigma_m is not None and len(faces):
        accepted = sigma <= max_sigma_m
        if not accepted[faces].all(1).any():
            raise DataError(
                f"no part of the surface has a sigma below {max_sigma_m * 100:g} cm: the median of its vertices is "
                f"{np.median(sigma) * 100:.2f} cm; give a larger --max-sigma"
            )
        index, faces = _selection(len(vertices), faces, accepted)
        vertices, colors, sigma = vertices[index], colors[index], sigma[index]
    if not len(faces):
        raise DataError(
            "the map has no surface: too few observations; map more frames, or lower --set fusion.min_observations"
        )
    return Mesh(vertices, faces, colors, sigma)


def visible_vertices(
    mesh: Mesh,
    camera: Camera,
    T_world_camera: Sequence[np.ndarray],
    tolerance_m: float,
    on_event: OnEvent = ignore,
    parameters: MeshExtractionParameters = PARAMETERS,
) -> np.ndarray:
    """(V,) bool: vertices that are the first surface (within `tolerance_m`) on the ray of some pixel of some camera."""
    surface = Surface(mesh)
    visible = np.zeros(len(mesh.vertices), dtype=bool)
    half = camera.resized(camera.width // 2, camera.height // 2)
    count = min(parameters.max_views, len(T_world_camera))
    chosen = np.unique(np.linspace(0, len(T_world_camera) - 1, count).astype(int))
    for view in track_progress(chosen, len(chosen), "keeping what was seen", on_event, "views"):
        T = T_world_camera[view]
        rows = np.flatnonzero(~visible)
        local = (mesh.vertices[rows] - T[:3, 3].astype(np.float32)) @ T[:3, :3].astype(np.float32)
        u, v, z = (values.numpy() for values in half.project(torch.from_numpy(local)))
        u, v = np.round(u), np.round(v)
        inside = half.contains(u, v)
        depth = surface.depth(half, T)[v[inside].astype(int), u[inside].astype(int)]
        slack_m = tolerance_m + parameters.max_slope * z[inside] / half.fx
        candidates = rows[inside][(z[inside] < depth + slack_m) & np.isfinite(depth) & (depth > 0)]
        visible[candidates] = _in_sight(surface, T[:3, 3], mesh.vertices[candidates], tolerance_m)
    return visible


def _in_sight(surface: Surface, centre: np.ndarray, points: np.ndarray, tolerance_m: float) -> np.ndarray:
    """(N,) bool: nothing lies more than `tolerance_m` in front of the points (N, 3) as seen from `centre` (3,)."""
    directions = points - centre.astype(points.dtype)
    distances = np.linalg.norm(directions, axis=1)
    hit = surface.cast(centre, directions) * distances
    in_sight: np.ndarray = (hit == 0) | (hit > distances - tolerance_m)  # no hit: the ray slipped past the border
    return in_sight


def _grid_at(field: NeuralField, voxel_size_m: float | None) -> tuple[SparseGrid, BlockSamples]:
    """The grid to extract from and its samples: the field's own, or one of another voxel size over the same surface."""
    own_size_m = field.grid.voxel_size_m
    if voxel_size_m is None or abs(voxel_size_m - own_size_m) < 1e-9:
        return field.grid, field.samples
    grid = SparseGrid(voxel_size_m, field.grid.device)
    near = (field.known & (field.base[:, 0].abs() < ACTIVE_VOXELS * own_size_m)).nonzero()[:, 0]
    offsets = field.grid.inner_offsets()
    for part in near.split(_VERTICES_AT_A_TIME):
        points = field.grid.blocks[part // ROWS] * field.grid.block_size_m + offsets[part % ROWS]
        ends = torch.cat([points - own_size_m, points + own_size_m])
        grid.allocate(torch.floor(ends / grid.block_size_m).long())

    def samples(ids: Tensor) -> tuple[Tensor, Tensor]:
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


def _select(vertices: np.ndarray, faces: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh without the vertices that are not `kept` (V,) and the faces that use one."""
    index, faces = _selection(len(vertices), faces, kept)
    return vertices[index], faces


def _selection(count: int, faces: np.ndarray, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the vertices that faces of `kept` vertices (V,) use, and these faces by their positions among them."""
    faces = faces[kept[faces].all(1)]
    used = np.unique(faces)
    position = np.zeros(count, np.int32)
    position[used] = np.arange(len(used), dtype=np.int32)
    return used, position[faces]


def _in_small_component(vertices: np.ndarray, faces: np.ndarray, min_area_m2: float) -> np.ndarray:
    """(V,) bool: vertices of connected pieces whose area is below `min_area_m2`."""
    if not len(faces):
        return np.zeros(len(vertices), dtype=bool)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(edges), bool), edges.T), shape=(len(vertices),) * 2)
    count, label = connected_components(graph, directed=False)
    small: np.ndarray = np.bincount(label[faces[:, 0]], weights=area, minlength=count)[label] < min_area_m2
    return small


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
