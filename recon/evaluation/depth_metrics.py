"""Depth error of a mesh: against the reference from new views, and against readings of frames that were held out."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..core.camera import Camera
from ..core.errors import DataError
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from .mesh_metrics import PointFilter, near_to

PAPER_CAMERA = Camera(500, 500, 300.0, 300.0, 249.5, 249.5)  # METHOD, Depth L1
QUICK_CAMERA = Camera(125, 125, 75.0, 75.0, 62.0, 62.0)  # the same field of view at a quarter of the size
BOX_SHARE = (0.3, 0.7, 0.7)  # METHOD, Depth L1: share of the reference's box, shortest side first
PAPER_LIFT_M = 0.4  # METHOD, Depth L1: the box of camera centres is moved up
FAR_M = 20.0  # METHOD, Depth L1
CLEARANCE_M = 0.2  # a new view keeps this far from the reference surface
COARSE_STEP = 10  # pixels between the rays that decide whether a view is usable
MIN_SHARE = 0.8  # of those rays that must meet the (seen) reference
DRAWS_PER_VIEW = 40


@dataclass(frozen=True)
class ViewSettings:
    """How new views are drawn. "paper": raised box, only views that show nothing unseen, as in METHOD, Depth L1."""

    views: int = 100
    protocol: Literal["standard", "paper"] = "standard"
    seed: int = 0

    @property
    def camera(self) -> Camera:
        return PAPER_CAMERA if self.protocol == "paper" else QUICK_CAMERA


@dataclass(frozen=True)
class NovelViewDepth:
    """Depth L1 against the reference.

    l1_all_m       mean |difference| over all compared pixels; where the mesh is missing its depth counts as 0
    l1_rendered_m  mean |difference| over the compared pixels where the mesh is, None if it is nowhere; with the paper's
                   protocol the mean over the views of the mean of each, as the published script has it
    completeness   share of the compared pixels where the mesh is
    """

    l1_all_m: float
    l1_rendered_m: float | None
    completeness: float
    views: int
    width: int
    height: int
    culled: bool
    settings: ViewSettings


@dataclass(frozen=True)
class HeldOutDepth:
    """Depth of the mesh against readings: error over the pixels where both are.

    completeness   share of the readings at whose pixel the mesh is
    """

    l1_m: float | None
    median_m: float | None
    completeness: float
    frames: int
    readings: int
    sensor: str


def novel_view_depth(
    mesh: Mesh, reference: Mesh, settings: ViewSettings, seen_reference: np.ndarray | None = None
) -> NovelViewDepth:
    """Depth L1 from views inside the reference (METHOD, Depth L1, variants A and B), both meshes in one frame, metres.

    `seen_reference` (M, 3): points of the reference that a camera saw; pixels that show other parts are left out.
    Raises DataError if no usable view is found.
    """
    surface, target = Surface(mesh), Surface(reference)
    was_seen = None if seen_reference is None else near_to(seen_reference)
    poses = sample_views(reference, target, settings, was_seen)
    sums = []  # of each view: |difference| over all pixels, over rendered pixels, pixels, rendered pixels
    for T_world_camera in poses:
        wanted = _within_range(target.depth(settings.camera, T_world_camera))
        found = _within_range(surface.depth(settings.camera, T_world_camera))
        compared = _compared(wanted, settings, T_world_camera, was_seen)
        difference = np.abs(found - wanted)[compared].astype(np.float64)
        rendered = found[compared] > 0
        sums.append((difference.sum(), difference[rendered].sum(), len(difference), rendered.sum()))
    total, _, pixels, pixels_rendered = np.sum(sums, axis=0)
    return NovelViewDepth(
        float(total / pixels),
        _l1_where_rendered(np.array(sums), settings),
        float(pixels_rendered / pixels),
        len(poses),
        settings.camera.width,
        settings.camera.height,
        seen_reference is not None,
        settings,
    )


def _l1_where_rendered(sums: np.ndarray, settings: ViewSettings) -> float | None:
    """(V, 4) sums of each view -> metres; None without a rendered pixel. Of the paper's views each weighs the same."""
    _, totals, _, pixels = sums[sums[:, 3] > 0].T
    if len(pixels) == 0:
        return None
    return float(np.mean(totals / pixels) if settings.protocol == "paper" else totals.sum() / pixels.sum())


def sample_views(
    reference: Mesh, surface: Surface, settings: ViewSettings, was_seen: PointFilter | None = None
) -> list[np.ndarray]:
    """Poses (4, 4) T_world_camera drawn uniformly in the shrunk box of the reference, looking anywhere.

    A view is drawn again if it comes close to a surface or looks out of the scene; the paper's only if it shows
    anything unseen, or nothing at all. Fewer than asked for come back if most draws fail. Raises DataError if all do.
    """
    rng = np.random.default_rng(settings.seed)
    center, axes, half = centre_box(reference, PAPER_LIFT_M if settings.protocol == "paper" else 0.0)
    rays = settings.camera.rays().numpy()[::COARSE_STEP, ::COARSE_STEP]
    poses: list[np.ndarray] = []
    for _ in range(settings.views * DRAWS_PER_VIEW):
        if len(poses) == settings.views:
            break
        position = center + axes @ (rng.uniform(-1.0, 1.0, 3) * half)
        T_world_camera = look_at(position, rng.uniform(-10_000.0, 10_000.0, 3))
        is_paper = settings.protocol == "paper"
        if not is_paper and surface.distance(position[None])[0] < CLEARANCE_M:
            continue
        depth = surface.cast(position, rays @ T_world_camera[:3, :3].T)
        seen = _seen_pixels(depth, rays, T_world_camera, was_seen)
        if (seen.any() and np.array_equal(seen, depth > 0)) if is_paper else seen.mean() >= MIN_SHARE:
            poses.append(T_world_camera)
    if not poses:
        raise DataError("no view from inside the reference mesh shows enough of it; depth from new views needs a room")
    return poses


def centre_box(reference: Mesh, lift_m: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre (3,), axes (3, 3; columns) and half sides (3,) of the box of camera centres, metres. Raises DataError."""
    import open3d as o3d

    corners = o3d.utility.Vector3dVector(reference.vertices.astype(np.float64))
    try:
        box = o3d.geometry.OrientedBoundingBox.create_from_points(corners, robust=True)
    except RuntimeError as error:
        raise DataError("the reference mesh has no volume; depth from new views needs a room") from error
    order = np.argsort(box.extent)
    return box.center + np.array([0.0, 0.0, lift_m]), box.R[:, order], 0.5 * box.extent[order] * BOX_SHARE


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) T_world_camera at `position` looking at `target`, OpenCV axes, image rows running along -z."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross([0.0, 0.0, -1.0], forward)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0.0, 0.0])
    T_world_camera = np.eye(4)
    T_world_camera[:3, :4] = np.column_stack([right, np.cross(forward, right), forward, position])
    return T_world_camera


def held_out_depth(
    mesh: Mesh, camera: Camera, frames: Iterable[tuple[np.ndarray, np.ndarray]], sensor: str
) -> HeldOutDepth:
    """Depth of `mesh` at the poses of `frames` against their readings.

    `frames` yields T_world_camera (4, 4) and depth (H, W) in metres, 0 = no reading.
    """
    surface = Surface(mesh)
    differences, readings, count = [np.zeros(0, dtype=np.float32)], 0, 0
    for T_world_camera, depth in frames:
        found = surface.depth(camera, T_world_camera)
        both = (depth > 0) & (found > 0)
        differences.append(np.abs(found - depth)[both])
        readings += int((depth > 0).sum())
        count += 1
    difference = np.concatenate(differences)
    met = len(difference) > 0
    return HeldOutDepth(
        float(difference.mean(dtype=np.float64)) if met else None,
        float(np.median(difference)) if met else None,
        len(difference) / readings if readings else 0.0,
        count,
        readings,
        sensor,
    )


def _within_range(depth: np.ndarray) -> np.ndarray:
    return np.where(depth <= FAR_M, depth, 0.0)


def _compared(
    wanted: np.ndarray, settings: ViewSettings, T_world_camera: np.ndarray, was_seen: PointFilter | None
) -> np.ndarray:
    """(H, W) bool. The paper compares all pixels of its views; otherwise those that show (seen) reference."""
    if settings.protocol == "paper":
        return np.ones(wanted.shape, dtype=bool)
    return _seen_pixels(wanted, settings.camera.rays().numpy(), T_world_camera, was_seen)


def _seen_pixels(
    depth: np.ndarray, rays: np.ndarray, T_world_camera: np.ndarray, was_seen: PointFilter | None
) -> np.ndarray:
    """(H, W) bool: pixels whose ray meets the reference, where it was seen."""
    valid = depth > 0
    if was_seen is not None and valid.any():
        local = rays[valid] * depth[valid][:, None]
        points = local @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        valid[valid] = was_seen(points)
    return valid
