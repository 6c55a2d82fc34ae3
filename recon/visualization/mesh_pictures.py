"""Pictures of a mesh: shaded, in its colours, by the sigma of its vertices, or by its distance to a ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import ConfigError, DataError, DependencyError
from ..core.events import Note, OnEvent, Warn, ignore
from ..core.far_frames import MIN_GAP_M, far_frames
from ..core.files import write_bytes, write_image
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from . import offscreen
from . import raycast_renderer as raycast_view
from .charts import ColorScale, picture_sheet
from .raycast_renderer import Pictures
from .shading import Geometry, Layer
from .views import DEFAULT_SIZE, View, mesh_views, run_views

MODES = ("shaded", "color", "sigma", "error")
RENDERERS = ("auto", "offscreen", "raycast")
MAX_SHOWN_ERROR_M = 0.05
_GREY = 222
_CONTRAST = {"shaded": 1.0, "color": 0.25, "sigma": 0.55, "error": 0.55}
_TITLES = {
    "shaded": "Surface",
    "color": "Colour",
    "sigma": "Sigma: expected distance to the true surface",
    "error": "Error: distance to the ground truth",
}


@dataclass(frozen=True)
class Snapshot:
    """The pictures of one mode, one per view; `scale` is the colour scale where colours encode a number."""

    mode: str
    views: tuple[View, ...]
    pictures: tuple[np.ndarray, ...]  # (H, W, 3) uint8 each
    scale: ColorScale | None
    renderer: str

    def save(self, folder: Path) -> Path:
        """Write every picture to `folder`/views and all of them on one sheet; returns the sheet. Raises RunError."""
        for view, picture in zip(self.views, self.pictures, strict=True):
            write_image(folder / "views" / f"{self.mode}_{view.name}.png", picture, png_level=6)
        sheet = folder / f"{self.mode}.png"
        titles = [view.title for view in self.views]
        write_bytes(sheet, picture_sheet(_TITLES[self.mode], titles, self.pictures, self.scale))
        return sheet


def available_modes(mesh: Mesh, reference: Mesh | None) -> tuple[str, ...]:
    """The modes for which `mesh` has the data."""
    has_data = {
        "shaded": True,
        "color": mesh.colors is not None,
        "sigma": mesh.sigma is not None,
        "error": reference is not None,
    }
    return tuple(mode for mode in MODES if has_data[mode])


def draw_mesh(
    mesh: Mesh,
    views: Sequence[View],
    modes: Sequence[str] | None = None,
    reference: Mesh | None = None,
    renderer: str = "auto",
    on_event: OnEvent = ignore,
) -> list[Snapshot]:
    """Draw `mesh` from every view in every mode (None: all that it has data for).

    Raises DataError if a mode lacks its data, ConfigError for an unknown mode or renderer, DependencyError if the
    chosen renderer does not run.
    """
    chosen = tuple(dict.fromkeys(modes)) if modes else available_modes(mesh, reference)
    painted = [paint(mesh, mode, reference) for mode in chosen]
    geometry = Geometry.build(mesh.vertices, mesh.faces)
    pictures, used = _render(geometry, [layer for layer, _ in painted], views, renderer, on_event)
    return [Snapshot(layer.name, tuple(views), tuple(pictures[layer.name]), scale, used) for layer, scale in painted]


def paint(mesh: Mesh, mode: str, reference: Mesh | None = None) -> tuple[Layer, ColorScale | None]:
    """The vertex colours of one mode and the scale that explains them. Raises DataError, ConfigError."""
    if mode not in MODES:
        raise ConfigError(f"unknown picture mode {mode!r}; choose from {', '.join(MODES)}")
    if mode == "shaded":
        return Layer(mode, np.full((len(mesh.vertices), 3), _GREY, np.uint8), _CONTRAST[mode]), None
    if mode == "color":
        if mesh.colors is None:
            raise DataError("the mesh has no vertex colours for the picture `color`; try --mode shaded")
        return Layer(mode, mesh.colors, _CONTRAST[mode]), None
    values, scale = _vertex_sigma(mesh) if mode == "sigma" else _error(mesh, reference)
    return Layer(mode, scale.paint(values), _CONTRAST[mode]), scale


def _vertex_sigma(mesh: Mesh) -> tuple[np.ndarray, ColorScale]:
    if mesh.sigma is None:
        raise DataError("the mesh has no sigma for the picture `sigma`; `uncle mesh` writes meshes with it")
    finite = mesh.sigma[np.isfinite(mesh.sigma)]
    highest = float(np.percentile(finite, 98)) if len(finite) else 0.0
    return mesh.sigma, ColorScale("1 sigma [cm]", 0.0, max(highest, 1e-3), "viridis_r", 100.0)


def _error(mesh: Mesh, reference: Mesh | None) -> tuple[np.ndarray, ColorScale]:
    if reference is None:
        raise DataError("the picture `error` needs a ground-truth mesh; give it with --gt")
    scale = ColorScale("distance to ground truth [cm]", 0.0, MAX_SHOWN_ERROR_M, "RdYlBu_r", 100.0)
    return Surface(reference).distance(mesh.vertices), scale


def _render(
    geometry: Geometry, layers: Sequence[Layer], views: Sequence[View], renderer: str, on_event: OnEvent
) -> tuple[Pictures, str]:
    if renderer not in RENDERERS:
        raise ConfigError(f"unknown renderer {renderer!r}; choose from {', '.join(RENDERERS)}")
    if renderer == "offscreen" or (renderer == "auto" and offscreen.is_available()):
        try:
            pictures = offscreen.render(geometry, layers, views, on_event)
            on_event(Note("pictures drawn with Open3D's OffscreenRenderer"))
            return pictures, "offscreen"
        except DependencyError as error:
            if renderer == "offscreen":
                raise
            on_event(Warn(f"{error}; the CPU ray caster is used instead"))
    pictures = raycast_view.render(geometry, layers, views, on_event)
    hint = f" (Open3D's OffscreenRenderer does not run here: {offscreen.INSTALL_HINT})" if renderer == "auto" else ""
    on_event(Note(f"pictures drawn with the CPU ray caster{hint}"))
    return pictures, "raycast"


def snapshot_views(mesh: Mesh, run: RunDirectory | None, size: tuple[int, int] = DEFAULT_SIZE) -> list[View]:
    """Viewpoints at the cameras of `run`, or around the mesh where there is no run or no pose."""
    poses = run_poses(run) if run is not None else np.zeros((0, 4, 4))
    if run is None or len(poses) == 0:
        return mesh_views(mesh.vertices, mesh.faces, size)
    poses, faces = _without_far_frames(poses, mesh)
    return run_views(poses, run.load_camera(), mesh.vertices, faces, size)


def _without_far_frames(poses: np.ndarray, mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Poses, and faces of the mesh around them, without those far from all others: a picture shows one place."""
    far = [index for group in far_frames(poses[:, :3, 3]) for index in group.indices]
    if not far:
        return poses, mesh.faces
    poses = np.delete(poses, far, axis=0)
    low, high = poses[:, :3, 3].min(0) - MIN_GAP_M, poses[:, :3, 3].max(0) + MIN_GAP_M
    near = ((mesh.vertices > low) & (mesh.vertices < high)).all(1)
    faces = mesh.faces[near[mesh.faces].all(1)]
    return poses, faces if len(faces) else mesh.faces


def run_poses(run: RunDirectory) -> np.ndarray:
    """(N, 4, 4) finite poses of a run: the estimated ones, else those of the data set; N = 0 if there are none."""
    if run.trajectory_path.is_file():
        return run.load_trajectory().finite().T_world_camera
    frames = RunFrames(run)
    poses = [pose for index in range(len(frames)) if (pose := frames.pose(index)) is not None]
    return np.array(poses, dtype=np.float64).reshape(-1, 4, 4)
