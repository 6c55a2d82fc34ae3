"""Viewpoints for pictures of a mesh: at the cameras of its run, or around it, framed automatically."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..core.camera import Camera
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface

DEFAULT_SIZE = (960, 720)
_FILL_RATIO = 0.47  # half-extent of the scene in a picture, relative to the width or height
_STEP_BACK_RATIO = 0.4  # a camera of the run steps back by this ratio of its median viewing distance
_AXIS_SNAP = np.cos(np.radians(10.0))  # an up direction this close to a world axis is snapped to it

Cut = Literal["back", "front", "near_sides", "nothing"]


@dataclass(frozen=True)
class View:
    """A viewpoint. `name` is part of a file name, `title` is shown above the picture.

    camera           pinhole of the picture
    T_world_camera   (4, 4) float64, OpenCV axes
    cut              triangles that are left out so that the inside of a room is visible: "back": those seen from
                     behind; "front": those seen from the front, for a mesh that is inside out; "near_sides": those on
                     the sides of the bounding box that face the viewer, for a mesh without a consistent front
    """

    name: str
    title: str
    camera: Camera
    T_world_camera: np.ndarray
    cut: Cut = "back"


def picture_camera(size: tuple[int, int], half_width_tangent: float) -> Camera:
    """Centred pinhole; `half_width_tangent` = tan(horizontal field of view / 2), `size` is in pixels."""
    width, height = size
    focal = 0.5 * width / half_width_tangent
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def rotation_towards(forward: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(3, 3) R_world_camera with the optical axis along `forward` (3,) and `up` (3,) upwards in the picture."""
    z = forward / np.linalg.norm(forward)
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-6:  # `forward` is parallel to `up`: any horizontal direction is right
        x = np.cross(z, np.roll(up, 1) + 0.1)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


def framed_view(
    name: str, title: str, points: np.ndarray, forward: np.ndarray, up: np.ndarray, size: tuple[int, int]
) -> View:
    """A view along `forward` from the distance at which all `points` (P, 3) just fill the picture."""
    camera = picture_camera(size, half_width_tangent=0.5)
    rotation = rotation_towards(forward, up)
    local = points @ rotation
    limits = np.array([_FILL_RATIO * camera.width / camera.fx, _FILL_RATIO * camera.height / camera.fy])
    eye = np.array([*(local[:, :2].min(0) + local[:, :2].max(0)) / 2, 0.0])
    for _ in range(5):  # distance for this centre, then the centre of what is seen from that distance
        eye[2] = (local[:, 2, None] - np.abs(local[:, :2] - eye[:2]) / limits).min()
        image = (local[:, :2] - eye[:2]) / np.maximum(local[:, 2] - eye[2], 1e-9)[:, None]
        eye[:2] += 0.5 * (image.min(0) + image.max(0)) * (np.median(local[:, 2]) - eye[2])
    eye[2] = (local[:, 2, None] - np.abs(local[:, :2] - eye[:2]) / limits).min()
    T_world_camera = np.eye(4)
    T_world_camera[:3, :3], T_world_camera[:3, 3] = rotation, rotation @ eye
    return View(name, title, camera, T_world_camera)


def mesh_views(
    vertices: np.ndarray, faces: np.ndarray, size: tuple[int, int] = DEFAULT_SIZE, up: np.ndarray | None = None
) -> list[View]:
    """Three views around a mesh, and one from above, where no camera poses are known.

    vertices (V, 3) metres, faces (F, 3); `up` (3,) is guessed where it is None.
    """
    points = framing_points(vertices, faces)
    up = guess_up(vertices, faces) if up is None else up
    cut: Cut = "near_sides" if _is_mixed(front_ratio(vertices, faces, *_rays_from_inside(points))) else "back"
    ahead, aside = horizontal_axes(up)
    views = []
    for angle in (40, 160, 280):
        azimuth = np.radians(angle)
        forward = np.cos(azimuth) * ahead + np.sin(azimuth) * aside - 0.65 * up
        shown = points if cut != "back" else framing_points(vertices, _front_faces(vertices, faces, forward))
        views.append(framed_view(f"around_{angle:03d}", f"around, {angle}°", shown, forward, up, size))
    views.append(framed_view("above", "from above", points, -up - 1e-3 * ahead, ahead, size))
    return [replace(view, cut=cut) for view in views]


def run_views(
    poses: np.ndarray,
    camera: Camera,
    vertices: np.ndarray,
    faces: np.ndarray,
    size: tuple[int, int] = DEFAULT_SIZE,
    count: int = 3,
) -> list[View]:
    """`count` cameras of a run, far apart and stepped back, and one overview from outside.

    poses (N, 4, 4) T_world_camera, finite; vertices (V, 3) metres, faces (F, 3).
    """
    points = framing_points(vertices, faces)
    up = trajectory_up(poses)
    tangent = float(np.clip(0.5 * camera.width / camera.fx, 0.55, 1.0))
    views = []
    for index in spread_poses(poses, count):
        pose = poses[index].copy()
        depths = (points - pose[:3, 3]) @ pose[:3, 2]
        distance = np.median(depths[depths > 0]) if (depths > 0).any() else 0.0
        pose[:3, 3] -= _STEP_BACK_RATIO * distance * pose[:3, 2]
        views.append(View(f"frame_{index:06d}", f"from frame {index}", picture_camera(size, tangent), pose))
    forward = poses[:, :3, 2].mean(0)
    forward -= (forward @ up) * up  # seen surfaces face the cameras: keep their mean direction, from further up
    forward = forward / np.linalg.norm(forward) if np.linalg.norm(forward) > 0.05 else horizontal_axes(up)[0]
    downward = forward - 1.3 * up
    ratio = front_ratio(vertices, faces, *_rays_of_cameras(poses, tangent))
    if _is_mixed(ratio):
        overview = framed_view("overview", "overview", points, downward, up, size)
        return [*(replace(view, cut="nothing") for view in views), replace(overview, cut="near_sides")]
    inside_out = ratio < 0.5
    shown = framing_points(vertices, _front_faces(vertices, faces, -downward if inside_out else downward))
    views.append(framed_view("overview", "overview", shown, downward, up, size))
    return [replace(view, cut="front") for view in views] if inside_out else views


def spread_poses(poses: np.ndarray, count: int) -> list[int]:
    """Indices, ascending, of up to `count` poses (N, 4, 4) that differ most in place and direction (farthest first)."""
    spread = max(float(np.linalg.norm(np.ptp(poses[:, :3, 3], axis=0))), 1e-6)
    features = np.concatenate([poses[:, :3, 3] / spread, poses[:, :3, 2]], axis=1)
    chosen = [0]
    distances = np.linalg.norm(features - features[0], axis=1)
    while len(chosen) < min(count, len(poses)):
        chosen.append(int(distances.argmax()))
        distances = np.minimum(distances, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return sorted(set(chosen))


def trajectory_up(poses: np.ndarray) -> np.ndarray:
    """(3,) up direction of hand-held poses (N, 4, 4), whose x axes are assumed level."""
    mean_up = -poses[:, :3, 1].mean(0)
    mean_up /= max(float(np.linalg.norm(mean_up)), 1e-9)
    rights = poses[:, :3, 0]
    values, vectors = np.linalg.eigh(rights.T @ rights / len(rights))
    if values[1] > 0.1 and abs(vectors[:, 0] @ mean_up) > 0.5:  # the camera turned, so two level directions are known
        mean_up = vectors[:, 0] * np.sign(vectors[:, 0] @ mean_up)
    return _snap(mean_up)


def guess_up(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(3,) the world axis that most area of the mesh faces, as floors and table tops do; z is preferred."""
    triangles = vertices[faces].astype(np.float64)
    areas = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    sizes = np.linalg.norm(areas, axis=1)
    best, most = np.array([0.0, 0.0, 1.0]), 0.0
    for axis, preference in ((2, 1.5), (1, 1.0)):  # nearly every data set has z or y upright, z more often
        for sign in (1.0, -1.0):
            total = preference * sizes[sign * areas[:, axis] > 0.9 * sizes].sum()
            if total > 1.02 * most:
                best, most = sign * np.eye(3)[axis], total
    return best


def horizontal_axes(up: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors (3,) orthogonal to `up` (3,) and to each other."""
    start = np.eye(3)[int(np.abs(up).argmin())]
    first = start - (start @ up) * up
    first /= np.linalg.norm(first)
    return first, np.cross(up, first)


def framing_points(vertices: np.ndarray, faces: np.ndarray, limit: int = 20000) -> np.ndarray:
    """(P, 3) surface points that a picture has to show, without the outermost half per cent on each side (outliers)."""
    used = vertices[np.unique(faces)] if len(faces) else vertices
    points = used[:: max(1, len(used) // limit)].astype(np.float64)
    if len(points) < 1000:
        return points
    low, high = np.percentile(points, [0.5, 99.5], axis=0)
    margin = 0.02 * (high - low)
    return points[((points >= low - margin) & (points <= high + margin)).all(1)]


def _snap(direction: np.ndarray) -> np.ndarray:
    axis = int(np.abs(direction).argmax())
    if abs(direction[axis]) < _AXIS_SNAP:
        return direction
    return np.sign(direction[axis]) * np.eye(3)[axis]


def front_ratio(vertices: np.ndarray, faces: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> float:
    """Ratio of the rays (R, 3), among those that hit the mesh, that hit a triangle from its front."""
    hit, normals = Surface(Mesh(vertices, faces)).hit_normals(origins, directions)
    if not hit.any():
        return 1.0
    return float((np.einsum("rx,rx->r", normals, directions)[hit] < 0).mean())


def _front_faces(vertices: np.ndarray, faces: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """(K, 3) the faces seen from the front along `forward`; all if there are none."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    front = normals @ forward < 0
    return faces[front] if front.any() else faces


def _is_mixed(ratio: float) -> bool:
    """Whether the mesh has no consistent front; a low ratio means that it is seen from behind everywhere."""
    return 0.2 < ratio < 0.8


def _rays_from_inside(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    return (points.min(0) + points.max(0)) / 2, directions / np.linalg.norm(directions, axis=1, keepdims=True)


def _rays_of_cameras(poses: np.ndarray, tangent: float) -> tuple[np.ndarray, np.ndarray]:
    chosen = poses[spread_poses(poses, 8)]
    grid = np.linspace(-0.8, 0.8, 12) * tangent
    local = np.array([[x, y, 1.0] for x in grid for y in grid])
    directions = np.einsum("nij,rj->nri", chosen[:, :3, :3], local).reshape(-1, 3)
    return np.repeat(chosen[:, :3, 3], len(local), axis=0), directions
