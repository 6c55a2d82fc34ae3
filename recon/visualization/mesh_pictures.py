"""Pictures of a mesh: shaded, in its colours, by the sigma of its vertices, or by its distance to a ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import ConfigError, DataError, DependencyError, RunError
from ..core.events import Note, OnEvent, Warn, ignore
from ..core.files import write_bytes, write_image
from ..core.mesh import Mesh
from ..core.trajectory import Trajectory
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from . import offscreen
from . import raycast_renderer as raycast_view
from .charts import ColorScale, picture_sheet
from .raycast_renderer import Pictures
from .shading import Geometry, Layer
from .views import DEFAULT_SIZE, View, finite_poses, mesh_views, run_views

MODES = ("shaded", "color", "sigma", "error")
RENDERERS = ("auto", "offscreen", "raycast")
ERROR_CLIP_M = 0.05
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
    """The pictures of one mode, one per view; `scale` explains their colours where they stand for a number."""

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
    """The modes for which `mesh` has what they show."""
    has = {
        "shaded": True,
        "color": mesh.colors is not None,
        "sigma": mesh.sigma is not None,
        "error": reference is not None,
    }
    return tuple(mode for mode in MODES if has[mode])


def draw_mesh(
    mesh: Mesh,
    views: Sequence[View],
    modes: Sequence[str] | None = None,
    reference: Mesh | None = None,
    renderer: str = "auto",
    on_event: OnEvent = ignore,
) -> list[Snapshot]:
    """Draw `mesh` from every view in every mode (None: all that it has data for).

    Raises DataError where a mode lacks its data, DependencyError where the renderer asked for does not run.
    """
    chosen = tuple(dict.fromkeys(modes)) if modes else available_modes(mesh, reference)
    painted = [paint(mesh, mode, reference) for mode in chosen]
    geometry = Geometry.build(mesh.vertices, mesh.faces)
    pictures, used = _render(geometry, [layer for layer, _ in painted], views, renderer, on_event)
    return [Snapshot(layer.name, tuple(views), tuple(pictures[layer.name]), scale, used) for layer, scale in painted]


def paint(mesh: Mesh, mode: str, reference: Mesh | None = None) -> tuple[Layer, ColorScale | None]:
    """The vertex colours of one mode and the scale that explains them. Raises DataError, ConfigError."""
    if mode not in MODES:
        raise ConfigError(f"there is no picture mode {mode!r}; choose from {', '.join(MODES)}")
    if mode == "shaded":
        return Layer(mode, np.full((len(mesh.vertices), 3), _GREY, np.uint8), _CONTRAST[mode]), None
    if mode == "color":
        if mesh.colors is None:
            raise DataError("the mesh has no vertex colours, so there is no `color` picture; ask for --mode shaded")
        return Layer(mode, mesh.colors, _CONTRAST[mode]), None
    values, scale = _vertex_sigma(mesh) if mode == "sigma" else _error(mesh, reference)
    return Layer(mode, scale.paint(values), _CONTRAST[mode]), scale


def _vertex_sigma(mesh: Mesh) -> tuple[np.ndarray, ColorScale]:
    if mesh.sigma is None:
        raise DataError("the mesh has no sigma, so there is no such picture; `uncle mesh` writes meshes that have")
    finite = mesh.sigma[np.isfinite(mesh.sigma)]
    highest = float(np.percentile(finite, 98)) if len(finite) else 0.0
    return mesh.sigma, ColorScale("1 sigma [cm]", 0.0, max(highest, 1e-3), "viridis_r", 100.0)


def _error(mesh: Mesh, reference: Mesh | None) -> tuple[np.ndarray, ColorScale]:
    if reference is None:
        raise DataError("an `error` picture needs a ground truth; name its mesh with --gt")
    scale = ColorScale("distance to ground truth [cm]", 0.0, ERROR_CLIP_M, "RdYlBu_r", 100.0)
    return surface_distance(mesh.vertices, reference), scale


def surface_distance(points: np.ndarray, reference: Mesh) -> np.ndarray:
    """(P,) metres from points (P, 3) to the nearest point of the triangles of `reference`."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        np.ascontiguousarray(reference.vertices, np.float32), np.ascontiguousarray(reference.faces, np.uint32)
    )
    return scene.compute_distance(o3d.core.Tensor(np.ascontiguousarray(points, np.float32))).numpy()


def _render(
    geometry: Geometry, layers: Sequence[Layer], views: Sequence[View], renderer: str, on_event: OnEvent
) -> tuple[Pictures, str]:
    if renderer not in RENDERERS:
        raise ConfigError(f"there is no renderer {renderer!r}; choose from {', '.join(RENDERERS)}")
    if renderer == "offscreen" or (renderer == "auto" and offscreen.is_available()):
        try:
            pictures = offscreen.render(geometry, layers, views, on_event)
            on_event(Note("pictures drawn with Open3D's OffscreenRenderer"))
            return pictures, "offscreen"
        except DependencyError as error:
            if renderer == "offscreen":
                raise
            on_event(Warn(f"{error}; the CPU ray caster draws instead"))
    pictures = raycast_view.render(geometry, layers, views, on_event)
    hint = f" (Open3D's OffscreenRenderer does not run here: {offscreen.INSTALL_HINT})" if renderer == "auto" else ""
    on_event(Note(f"pictures drawn with the CPU ray caster{hint}"))
    return pictures, "raycast"


def snapshot_views(mesh: Mesh, run: RunDirectory | None, size: tuple[int, int] = DEFAULT_SIZE) -> list[View]:
    """Viewpoints from the cameras of `run`, or around the mesh where there is no run or no pose."""
    poses = run_poses(run) if run is not None else np.zeros((0, 4, 4))
    if run is None or len(poses) == 0:
        return mesh_views(mesh.vertices, mesh.faces, size)
    return run_views(poses, run.load_camera(), mesh.vertices, mesh.faces, size)


def run_poses(run: RunDirectory) -> np.ndarray:
    """(N, 4, 4) finite poses of a run: estimated ones first, else those of the data set; none gives N = 0."""
    if run.trajectory_path.is_file():
        return finite_poses(list(Trajectory.load(run.trajectory_path).T_world_camera))
    frames = RunFrames(run)
    return finite_poses([frames.pose(index) for index in range(len(frames))])


def load_run_mesh(run: RunDirectory) -> Mesh:
    """Raises RunError naming the command that makes the mesh."""
    if not run.mesh_path.is_file():
        run.manifest  # noqa: B018 - says so where there is no run at all
        raise RunError(f"{run.root} has no mesh; make it with `uncle mesh --run {run.root}` first")
    return Mesh.load(run.mesh_path)


def load_reference(run: RunDirectory) -> Mesh | None:
    """The ground-truth mesh that the data set of a run names, if it is (still) there."""
    named = run.manifest.reference_mesh
    return Mesh.load(Path(named)) if named and Path(named).is_file() else None
