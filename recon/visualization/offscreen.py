"""Drawing a mesh with Open3D's OffscreenRenderer, in a separate process.

The renderer needs a Vulkan or EGL driver. Without one it may raise, abort the process or hang, and with one it writes
to the standard streams; a separate process contains all of that.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ..core.camera import Camera
from ..core.errors import DependencyError
from ..core.events import OnEvent, ignore, track_progress
from ..core.files import read_image, write_image
from .raycast_renderer import Pictures
from .shading import SUPERSAMPLING, Geometry, Layer, average_down, light_triangles
from .views import View

Renderer = Any  # open3d.visualization.rendering.OffscreenRenderer, which has no types

INSTALL_HINT = "sudo apt-get install -y libvulkan1 mesa-vulkan-drivers"
_START_SECONDS = 120.0  # time limit; starting a driver can be slow on a loaded machine
_SECONDS_PER_PICTURE = 4.0  # time limit; 0.5 s is usual at 960 x 720 with a software driver
_MAX_TRIANGLES = 2_000_000  # in one process, over all its pictures


@cache
def is_available() -> bool:
    """Whether the renderer works here: one tiny picture, drawn once per process."""
    triangle = Geometry.build(np.array([[-1, -1, 2], [0, 1, 2], [1, -1, 2]], np.float32), np.array([[0, 1, 2]]))
    layer = Layer("probe", np.full((3, 3), 128, np.uint8), 0.0)
    view = View("probe", "probe", Camera(16, 16, 16.0, 16.0, 7.5, 7.5), np.eye(4), "nothing")
    try:
        picture = _render_in_process(triangle, [layer], [view], _START_SECONDS)["probe"][0]
    except DependencyError:
        return False
    return bool(abs(int(picture[8, 8, 0]) - 128) < 16)  # some drivers draw nothing, or wrong colours


def render(geometry: Geometry, layers: Sequence[Layer], views: Sequence[View], on_event: OnEvent = ignore) -> Pictures:
    """Draw every layer from every view. Raises DependencyError where the renderer does not run."""
    at_once = max(1, _MAX_TRIANGLES // max(1, len(geometry.faces) * len(layers)))
    seconds = _START_SECONDS + _SECONDS_PER_PICTURE * min(at_once, len(views)) * len(layers) * (
        1 + len(geometry.faces) / 1e6
    )
    pictures: Pictures = {layer.name: [] for layer in layers}
    batches = [views[start : start + at_once] for start in range(0, len(views), at_once)]
    for batch in track_progress(batches, len(batches), "snapshot", on_event, unit="batches"):
        for name, batch_pictures in _render_in_process(geometry, layers, batch, seconds).items():
            pictures[name] += batch_pictures
    return pictures


def _render_in_process(geometry: Geometry, layers: Sequence[Layer], views: Sequence[View], seconds: float) -> Pictures:
    with tempfile.TemporaryDirectory(prefix="uncle-snapshot-") as folder:
        job = Path(folder)
        np.savez(job / "geometry.npz", vertices=geometry.vertices, faces=geometry.faces)
        colors: dict[str, Any] = {layer.name: layer.colors for layer in layers}
        np.savez(job / "layers.npz", **colors)
        (job / "job.json").write_text(json.dumps(_describe(layers, views)))
        command = [sys.executable, "-m", __name__, folder]
        try:
            done = subprocess.run(command, capture_output=True, timeout=seconds, stdin=subprocess.DEVNULL, check=False)
        except subprocess.TimeoutExpired as error:
            raise DependencyError(_unusable(f"no answer within {seconds:.0f} s")) from error
        if done.returncode != 0:
            raise DependencyError(_unusable(_last_line(done.stderr) or f"exit code {done.returncode}"))
        return {
            layer.name: [read_image(_picture(job, layer.name, i), cv2.IMREAD_COLOR) for i in range(len(views))]
            for layer in layers
        }


def _describe(layers: Sequence[Layer], views: Sequence[View]) -> dict[str, list[dict[str, Any]]]:
    return {
        "layers": [{"name": layer.name, "contrast": layer.contrast} for layer in layers],
        "views": [
            {"camera": view.camera.to_dict(), "T_world_camera": view.T_world_camera.tolist(), "cut": view.cut}
            for view in views
        ],
    }


def _picture(job: Path, layer: str, view: int) -> Path:
    return job / f"{layer}_{view}.png"


def _unusable(reason: str) -> str:
    return f"Open3D's offscreen renderer does not run here ({reason}); install a driver with `{INSTALL_HINT}`"


def _last_line(stream: bytes) -> str:
    lines = stream.decode(errors="replace").strip().splitlines()
    return lines[-1][:200] if lines else ""


# --- the separate process ---------------------------------------------------------------------------------------


def _work(job: Path) -> None:
    """Draw what `_render_in_process` left in `job`."""
    description = json.loads((job / "job.json").read_text())
    with np.load(job / "geometry.npz") as arrays:
        geometry = Geometry.build(arrays["vertices"], arrays["faces"])
    with np.load(job / "layers.npz") as arrays:
        layers = [Layer(row["name"], arrays[row["name"]], row["contrast"]) for row in description["layers"]]
    views = [
        View("", "", Camera(**row["camera"]), np.array(row["T_world_camera"]), row["cut"])
        for row in description["views"]
    ]
    # All pictures are one geometry, uploaded once: each has its own copy of the triangles in the axes of its camera,
    # shifted so far that no camera sees the next copy. With a software driver the renderer can hang if geometries are
    # added or removed one by one (observed with Open3D 0.20 and Mesa 22.3).
    copies = [(index, layer) for index in range(len(views)) for layer in layers]
    reach = max(_farthest(view, geometry.vertices) for view in views)
    aside = np.array([reach * (1.1 + max(_half_width_tangent(view.camera) for view in views)), 0.0, 0.0])
    corners, colors = [], []
    for place, (index, layer) in enumerate(copies):
        lit, T_world_camera = light_triangles(geometry, views[index]), views[index].T_world_camera
        local = (geometry.vertices - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
        corners.append(local[lit.faces].reshape(-1, 3) + place * aside)
        colors.append(lit.paint(layer).reshape(-1, 3))
    renderer = _open_renderer(views[0].camera)
    _upload(renderer, np.concatenate(corners), np.concatenate(colors))
    for place, (index, layer) in enumerate(copies):
        _aim(renderer, views[index].camera, place * aside, reach)
        image = np.asarray(renderer.render_to_image())[..., :3]
        write_image(_picture(job, layer.name, index), average_down(image))


def _farthest(view: View, vertices: np.ndarray) -> float:
    return float(np.linalg.norm(vertices - view.T_world_camera[:3, 3], axis=1).max())


def _half_width_tangent(camera: Camera) -> float:
    return max(camera.cx + 0.5, camera.width - camera.cx - 0.5) / camera.fx


def _open_renderer(camera: Camera) -> Renderer:
    from open3d.visualization import rendering

    renderer = rendering.OffscreenRenderer(camera.width * SUPERSAMPLING, camera.height * SUPERSAMPLING)
    renderer.scene.set_background([1.0, 1.0, 1.0, 1.0])
    renderer.scene.view.set_post_processing(False)  # colours are final: no tone mapping, no bloom
    return renderer


def _aim(renderer: Renderer, camera: Camera, eye: np.ndarray, reach: float) -> None:
    """Point the renderer's camera along z from `eye` (3,), y down; the far plane is at about `reach` metres."""
    fine = camera.resized(camera.width * SUPERSAMPLING, camera.height * SUPERSAMPLING)
    intrinsic = fine.matrix
    intrinsic[:2, 2] += 0.5  # Open3D's renderer counts pixels from their corner
    renderer.scene.camera.set_projection(
        intrinsic, max(0.01, reach * 1e-4), reach * 1.05, float(fine.width), float(fine.height)
    )
    renderer.scene.camera.look_at(eye + np.array([0.0, 0.0, 1.0]), eye, np.array([0.0, -1.0, 0.0]))


def _upload(renderer: Renderer, corners: np.ndarray, colors: np.ndarray) -> None:
    """Add separate triangles to the scene: corners (3K, 3) with colors (3K, 3) 0..255."""
    import open3d as o3d

    if len(corners) == 0:  # Open3D rejects an empty geometry; a degenerate triangle is invisible
        corners, colors = np.zeros((3, 3)), np.zeros((3, 3))
    triangles = o3d.geometry.TriangleMesh()
    triangles.vertices = o3d.utility.Vector3dVector(corners.astype(np.float64))
    triangles.triangles = o3d.utility.Vector3iVector(np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    triangles.vertex_colors = o3d.utility.Vector3dVector(np.clip(colors / 255.0, 0, 1).astype(np.float64))
    material = o3d.visualization.rendering.MaterialRecord()
    material.shader = "defaultUnlit"
    renderer.scene.add_geometry("triangles", triangles, material)


if __name__ == "__main__":
    _work(Path(sys.argv[1]))
    sys.stdout.flush()
    os._exit(0)  # the pictures are written; destroying the renderer can hang
