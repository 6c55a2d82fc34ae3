"""Polygons as a mesh file states them, the checks of their numbers, and their triangles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import DataError
from ..world_offset import NO_OFFSET, Offset, world_offset

MAX_ROUNDING_M = 0.001  # vertices are kept as float32; a coarser one is reported


@dataclass(frozen=True)
class Polygons:
    """What a parser found in a file.

    vertices    (V, 3) float64
    counts      (F,) int64 number of corners of each face
    corners     (sum of counts,) int64 vertex of each corner, face after face, from 0
    colors      (V, 3) uint8 RGB or None
    sigma       (V,) float32 or None
    index_base  number of the first vertex in the file: 1 in OBJ
    is_single   whether the file holds coordinates in single precision
    notes       what the parser left out, one line each
    """

    vertices: np.ndarray
    counts: np.ndarray
    corners: np.ndarray
    colors: np.ndarray | None = None
    sigma: np.ndarray | None = None
    index_base: int = 0
    is_single: bool = False
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Triangles:
    """vertices (V, 3) float32 relative to offset_m; faces (T, 3) int32, none for a point cloud; colors (V, 3) uint8 or
    None; sigma (V,) float32 or None; notes: what was left out, one line each."""

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None
    sigma: np.ndarray | None
    notes: tuple[str, ...]
    offset_m: Offset = NO_OFFSET


def to_triangles(path: Path, polygons: Polygons, offset_m: Offset | None = None) -> Triangles:
    """Check the polygons of the file `path` and split them into triangles.

    offset_m   subtracted from the vertices before they are rounded; None: the one of `world_offset`

    Vertices that no face uses, and faces with fewer than three different corners, are left out with a note. A file
    without faces is a point cloud; its points that are not finite are left out with a note. Raises DataError for an
    index without a vertex, a face with a vertex that is not finite, or no finite vertex at all.
    """
    notes = list(polygons.notes)
    vertices = polygons.vertices
    _check_indices(path, polygons)
    faces = triangulate(vertices, polygons.counts, polygons.corners)
    narrow = int((polygons.counts < 3).sum())
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    narrow += int((~distinct).sum())
    faces = faces[distinct]
    if narrow:
        notes.append(f"{narrow} faces have fewer than three different corners and are left out")
    finite = np.isfinite(vertices).all(axis=1) & (np.abs(vertices) < np.finfo(np.float32).max).all(axis=1)
    if len(faces):
        _check_used_vertices(path, finite, faces, polygons.index_base)
        kept = np.zeros(len(vertices), dtype=bool)
        kept[faces] = True
        if not kept.all():
            notes.append(f"{int((~kept).sum())} of {len(vertices)} vertices belong to no face and are left out")
    else:
        kept = finite
        if not kept.any():
            what = "no points" if len(vertices) == 0 else f"none of its {len(vertices)} points is finite"
            raise DataError(f"{path} holds no triangles, and {what}: not a mesh, or an empty one")
        if not kept.all():
            notes.append(f"{int((~kept).sum())} of {len(vertices)} points are not finite and are left out")
    offset_m = world_offset(vertices[kept]) if offset_m is None else offset_m
    stated_m = float(np.abs(vertices[kept]).max()) if polygons.is_single else 0.0
    vertices = vertices - offset_m
    farthest_m = max(float(np.abs(vertices[kept]).max()), stated_m)
    rounding = np.spacing(np.float32(farthest_m)) / 2
    if rounding > MAX_ROUNDING_M:
        where = " in the file itself, which has single precision" if farthest_m == stated_m else ""
        notes.append(
            f"coordinates reach {farthest_m:.0f} m and are rounded by up to {rounding * 1000:.0f} mm{where}; subtract "
            "an offset from them first, the same from every file that belongs to them"
        )
    renumbered = np.cumsum(kept) - 1
    return Triangles(
        vertices[kept].astype(np.float32),
        renumbered[faces].astype(np.int32).reshape(-1, 3),
        None if polygons.colors is None else polygons.colors[kept],
        None if polygons.sigma is None else polygons.sigma[kept],
        tuple(notes),
        offset_m,
    )


def triangulate(vertices: np.ndarray, counts: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(T, 3) int64 triangles of polygons (see `Polygons`) in the order of the file; the winding is kept.

    Convex polygons become a fan around their first corner, concave ones are split by ear clipping.
    """
    starts = np.cumsum(counts) - counts
    triangles = [np.zeros((0, 3), dtype=np.int64)]
    owners = [np.zeros(0, dtype=np.int64)]
    for count in np.unique(counts[counts >= 3]):
        rows = np.flatnonzero(counts == count)
        polygons = corners[starts[rows][:, None] + np.arange(count)]
        fans = np.stack(
            [np.stack([polygons[:, 0], polygons[:, k], polygons[:, k + 1]], 1) for k in range(1, count - 1)], 1
        )
        if count > 3:
            for row in np.flatnonzero(~_fan_fits(vertices, polygons)):
                fans[row] = _clip_ears(vertices[polygons[row]], polygons[row])
        triangles.append(fans.reshape(-1, 3))
        owners.append(np.repeat(rows, count - 2))
    order = np.argsort(np.concatenate(owners), kind="stable")
    return np.concatenate(triangles)[order]


def pack(faces: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """`counts` and `corners` of (F, n) arrays of polygons with the same number of corners each."""
    counts = [np.full(len(block), block.shape[1], dtype=np.int64) for block in faces]
    corners = [block.astype(np.int64).reshape(-1) for block in faces]
    return np.concatenate([np.zeros(0, np.int64), *counts]), np.concatenate([np.zeros(0, np.int64), *corners])


def strip_triangles(strip: np.ndarray) -> np.ndarray:
    """(N,) vertices of a triangle strip -> (N - 2, 3) triangles, all wound like the first."""
    triangles = np.stack([strip[:-2], strip[1:-1], strip[2:]], axis=1)
    triangles[1::2] = triangles[1::2][:, [1, 0, 2]]
    return triangles


def _check_indices(path: Path, polygons: Polygons) -> None:
    size, base = len(polygons.vertices), polygons.index_base
    outside = np.flatnonzero((polygons.corners < 0) | (polygons.corners >= size))
    if len(outside) == 0:
        return
    face = int(np.searchsorted(np.cumsum(polygons.counts), outside[0], side="right"))
    there = f"only {size} (numbers {base} to {size - 1 + base})" if size else "none"
    raise DataError(
        f"{path}: face {face + base} names vertex {int(polygons.corners[outside[0]]) + base}, but there are {there}; "
        "the file is damaged"
    )


def _check_used_vertices(path: Path, finite: np.ndarray, faces: np.ndarray, base: int) -> None:
    broken = ~finite[faces].all(axis=1)
    if broken.any():
        vertices = np.flatnonzero(~finite)
        raise DataError(
            f"{path}: {len(vertices)} of {len(finite)} vertices are not finite (the first: {vertices[0] + base}), and "
            f"{int(broken.sum())} faces use them; remove them first"
        )


def _fan_fits(vertices: np.ndarray, polygons: np.ndarray) -> np.ndarray:
    """(P,) bool: all triangles of the fan around the first corner of the (P, n) polygons face the same way."""
    points = vertices[polygons]
    edges = points[:, 1:] - points[:, :1]
    with np.errstate(invalid="ignore", over="ignore"):
        normals = np.cross(edges[:, :-1], edges[:, 1:])  # twice the area of each triangle of the fan
        total = normals.sum(axis=1, keepdims=True)  # Newell's normal
        along = (normals * total).sum(axis=2)
        fits: np.ndarray = (along >= -1e-9 * np.abs(along).max(axis=1, keepdims=True)).all(axis=1)
    fits |= ~np.isfinite(points).all(axis=(1, 2))
    return fits


def _clip_ears(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(n - 2, 3) triangles of one simple polygon, projected along its normal (Meisters 1975)."""
    normal = np.cross(points[1:-1] - points[0], points[2:] - points[0]).sum(axis=0)
    axis = int(np.argmax(np.abs(normal)))
    flat = np.delete(points, axis, axis=1)
    if (normal[axis] > 0) == (axis == 1):  # deleting y mirrors the plane
        flat = flat[:, ::-1]
    remaining, triangles = list(range(len(points))), []
    while len(remaining) > 3:
        for at in range(len(remaining)):
            ear = [remaining[at - 1], remaining[at], remaining[(at + 1) % len(remaining)]]
            if _is_ear(flat, ear, remaining):
                break
        else:
            at, ear = 1, remaining[:3]  # the polygon crosses itself: no split is right, any is as good
        triangles.append(ear)
        del remaining[at]
    split: np.ndarray = corners[np.array([*triangles, remaining])]
    return split


def _is_ear(flat: np.ndarray, ear: list[int], remaining: list[int]) -> bool:
    a, b, c = flat[ear]
    if _turn(a, b, c) <= 0:
        return False
    others = flat[[i for i in remaining if i not in ear]]
    inside = (_turn(a, b, others) >= 0) & (_turn(b, c, others) >= 0) & (_turn(c, a, others) >= 0)
    corners = (others[:, None] == flat[ear][None]).all(axis=2).any(axis=1)  # a hole's bridge visits a place twice
    return not (inside & ~corners).any()


def _turn(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Twice the signed area of the triangles a b c of the plane; positive if they turn left."""
    turn: np.ndarray = (b[0] - a[0]) * (c[..., 1] - a[1]) - (b[1] - a[1]) * (c[..., 0] - a[0])
    return turn
