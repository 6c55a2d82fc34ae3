"""Depth error of a mesh: against the reference from new views, and against depth images of held-out frames.

docs/evaluation.md describes both protocols.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..core.camera import Camera
from ..core.errors import DataError
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from .mesh_metrics import PointFilter, ScoringProtocol, near_to


@dataclass(frozen=True)
class NewViewParameters:
    """How new views of the reference are drawn and compared.

    camera              pinhole of the rendered depth images
    box_ratios          camera centres lie in the oriented bounding box of the reference, shrunk by these ratios of its
                        sides, shortest side first
    lift_m              the box is moved up (along z) by this
    max_depth_m         depth beyond this counts as missing
    clearance_m         a view closer to the reference surface than this is drawn again; None: it is kept
    ray_step            pixels between the rays that decide whether a view is usable
    min_seen_ratio      ratio of those rays that must meet the (seen) reference; None: every ray that meets the
                        reference must meet a seen part, and at least one must
    compares_all_pixels compare all pixels of a view; else only those that show the (seen) reference
    mean_of_views       average the error over rendered pixels per view first, so that each view has the same weight
    draws_per_view      views are drawn at most this often for each that is wanted
    default_views       number of views unless the caller says otherwise
    """

    camera: Camera
    box_ratios: tuple[float, float, float] = (0.3, 0.7, 0.7)
    lift_m: float = 0.0
    max_depth_m: float = 20.0
    clearance_m: float | None = 0.2
    ray_step: int = 10
    min_seen_ratio: float | None = 0.8
    compares_all_pixels: bool = False
    mean_of_views: bool = False
    draws_per_view: int = 40
    default_views: int = 100


NEW_VIEW_PARAMETERS: dict[ScoringProtocol, NewViewParameters] = {
    "standard": NewViewParameters(camera=Camera(125, 125, 75.0, 75.0, 62.0, 62.0)),
    "paper": NewViewParameters(
        camera=Camera(500, 500, 300.0, 300.0, 249.5, 249.5), lift_m=0.4, clearance_m=None, min_seen_ratio=None,
        compares_all_pixels=True, mean_of_views=True, default_views=1000,
    ),
}  # fmt: skip


@dataclass(frozen=True)
class ViewSettings:
    """Number of new views, the protocol that decides how they are drawn, and the seed."""

    views: int = NEW_VIEW_PARAMETERS["standard"].default_views
    protocol: ScoringProtocol = "standard"
    seed: int = 0

    @property
    def parameters(self) -> NewViewParameters:
        """Those of the protocol."""
        return NEW_VIEW_PARAMETERS[self.protocol]


@dataclass(frozen=True)
class NovelViewDepth:
    """Depth L1 against the reference.

    l1_all_m       mean |difference| over all compared pixels; where the mesh is missing its depth counts as 0
    l1_rendered_m  mean |difference| over the compared pixels that show the mesh, None if there are none; with the
                   paper's protocol the mean over the views of the mean of each
    completeness   ratio of the compared pixels that show the mesh
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
    """Depth of the mesh against depth images of held-out frames, over the pixels where both have a value.

    completeness   ratio of the measurements whose pixel shows the mesh
    """

    l1_m: float | None
    median_m: float | None
    completeness: float
    frames: int
    measurements: int
    sensor: str


def novel_view_depth(
    mesh: Mesh, reference: Mesh, settings: ViewSettings, seen_reference: np.ndarray | None = None
) -> NovelViewDepth:
    """Depth L1 from views inside the reference, both meshes in one frame, metres.

    `seen_reference` (M, 3): points of the reference that a camera saw; pixels that show other parts are left out.
    Raises DataError if no usable view is found, or none shows the reference within the range of depth.
    """
    parameters, camera = settings.parameters, settings.parameters.camera
    surface, target = Surface(mesh), Surface(reference)
    was_seen = None if seen_reference is None else near_to(seen_reference)
    poses = sample_views(reference, target, settings, was_seen)
    sums = []  # of each view: |difference| over all pixels, over rendered pixels, pixels, rendered pixels
    for T_world_camera in poses:
        true_depth = _within_range(target.depth(camera, T_world_camera), parameters)
        depth = _within_range(surface.depth(camera, T_world_camera), parameters)
        compared = _compared_pixels(true_depth, parameters, T_world_camera, was_seen)
        difference = np.abs(depth - true_depth)[compared].astype(np.float64)
        rendered = depth[compared] > 0
        sums.append((difference.sum(), difference[rendered].sum(), len(difference), rendered.sum()))
    total, _, pixels, pixels_rendered = np.sum(sums, axis=0)
    if pixels == 0:
        raise DataError(f"no view shows the reference mesh within {parameters.max_depth_m:g} m")
    return NovelViewDepth(
        l1_all_m=float(total / pixels),
        l1_rendered_m=_l1_where_rendered(np.array(sums), parameters),
        completeness=float(pixels_rendered / pixels),
        views=len(poses),
        width=camera.width,
        height=camera.height,
        culled=seen_reference is not None,
        settings=settings,
    )


def _l1_where_rendered(sums: np.ndarray, parameters: NewViewParameters) -> float | None:
    """(V, 4) sums of each view -> metres; None without a rendered pixel."""
    _, totals, _, pixels = sums[sums[:, 3] > 0].T
    if len(pixels) == 0:
        return None
    return float(np.mean(totals / pixels) if parameters.mean_of_views else totals.sum() / pixels.sum())


def sample_views(
    reference: Mesh, surface: Surface, settings: ViewSettings, was_seen: PointFilter | None = None
) -> list[np.ndarray]:
    """Poses (4, 4) T_world_camera drawn uniformly in the shrunk box of the reference, with random directions.

    A view that is not usable is drawn again (`NewViewParameters`). Fewer than `settings.views` are returned if most
    draws fail. Raises DataError if all do.
    """
    parameters = settings.parameters
    rng = np.random.default_rng(settings.seed)
    center, axes, half = centre_box(reference, parameters)
    rays = parameters.camera.rays().numpy()[:: parameters.ray_step, :: parameters.ray_step]
    poses: list[np.ndarray] = []
    for _ in range(settings.views * parameters.draws_per_view):
        if len(poses) == settings.views:
            break
        position = center + axes @ (rng.uniform(-1.0, 1.0, 3) * half)
        T_world_camera = pose_towards(position, rng.uniform(-10_000.0, 10_000.0, 3))
        clearance_m = parameters.clearance_m
        if clearance_m is not None and surface.distance(position[None])[0] < clearance_m:
            continue
        depth = surface.cast(position, rays @ T_world_camera[:3, :3].T)
        seen = _seen_pixels(depth, rays, T_world_camera, was_seen)
        if _is_usable(seen, depth, parameters):
            poses.append(T_world_camera)
    if not poses:
        raise DataError("no view from inside the reference mesh shows enough of it; depth from new views needs a room")
    return poses


def _is_usable(seen: np.ndarray, depth: np.ndarray, parameters: NewViewParameters) -> bool:
    """Whether a view with these seen pixels (H, W) and depths (H, W) is kept."""
    if parameters.min_seen_ratio is None:
        return bool(seen.any() and np.array_equal(seen, depth > 0))
    return bool(seen.mean() >= parameters.min_seen_ratio)


def centre_box(reference: Mesh, parameters: NewViewParameters) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre (3,), axes (3, 3; columns) and half sides (3,) of the box of camera centres, metres. Raises DataError."""
    import open3d as o3d

    corners = o3d.utility.Vector3dVector(reference.vertices.astype(np.float64))
    try:
        box = o3d.geometry.OrientedBoundingBox.create_from_points(corners, robust=True)
    except RuntimeError as error:
        raise DataError("the reference mesh has no volume; depth from new views needs a room") from error
    order = np.argsort(box.extent)
    center = box.center + np.array([0.0, 0.0, parameters.lift_m])
    return center, box.R[:, order], 0.5 * box.extent[order] * parameters.box_ratios


def pose_towards(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(4, 4) T_world_camera at `position` (3,) with its optical axis towards `target` (3,), image rows along -z."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross([0.0, 0.0, -1.0], forward)
    right = right / np.linalg.norm(right) if np.linalg.norm(right) > 1e-9 else np.array([1.0, 0.0, 0.0])
    T_world_camera = np.eye(4)
    T_world_camera[:3, :4] = np.column_stack([right, np.cross(forward, right), forward, position])
    return T_world_camera


def held_out_depth(
    mesh: Mesh, camera: Camera, frames: Iterable[tuple[np.ndarray, np.ndarray]], sensor: str
) -> HeldOutDepth:
    """Depth of `mesh` rendered at the poses of `frames` against their depth images.

    `frames` yields T_world_camera (4, 4) and depth (H, W) in metres, 0 = no measurement.
    """
    surface = Surface(mesh)
    differences, measurements, count = [np.zeros(0, dtype=np.float32)], 0, 0
    for T_world_camera, depth in frames:
        rendered = surface.depth(camera, T_world_camera)
        both = (depth > 0) & (rendered > 0)
        differences.append(np.abs(rendered - depth)[both])
        measurements += int((depth > 0).sum())
        count += 1
    difference = np.concatenate(differences)
    has_any = len(difference) > 0
    return HeldOutDepth(
        l1_m=float(difference.mean(dtype=np.float64)) if has_any else None,
        median_m=float(np.median(difference)) if has_any else None,
        completeness=len(difference) / measurements if measurements else 0.0,
        frames=count,
        measurements=measurements,
        sensor=sensor,
    )


def _within_range(depth: np.ndarray, parameters: NewViewParameters) -> np.ndarray:
    return np.where(depth <= parameters.max_depth_m, depth, 0.0)


def _compared_pixels(
    true_depth: np.ndarray, parameters: NewViewParameters, T_world_camera: np.ndarray, was_seen: PointFilter | None
) -> np.ndarray:
    """(H, W) bool."""
    if parameters.compares_all_pixels:
        return np.ones(true_depth.shape, dtype=bool)
    return _seen_pixels(true_depth, parameters.camera.rays().numpy(), T_world_camera, was_seen)


def _seen_pixels(
    depth: np.ndarray, rays: np.ndarray, T_world_camera: np.ndarray, was_seen: PointFilter | None
) -> np.ndarray:
    """(H, W) bool: pixels whose ray meets a part of the reference that was seen; all parts without `was_seen`."""
    valid = depth > 0
    if was_seen is not None and valid.any():
        local = rays[valid] * depth[valid][:, None]
        points = local @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        valid[valid] = was_seen(points)
    return valid
