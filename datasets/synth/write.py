"""Make a data set: render a room from a hand-held path, simulate its sensors, write it in SenFuNet-Replica layout."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from ...recon.core.camera import Camera
from ...recon.core.errors import ConfigError, RunError
from ...recon.core.events import Note, OnEvent, ignore, track_progress
from ...recon.core.files import DEPTH_UNITS_PER_M, encode_metres, explain_write_errors, write_image, write_text
from ..poses import OPENGL_TO_OPENCV, Z_UP_FROM_Y_UP
from . import sensors as active
from . import stereo
from .corridor import corridor, corridor_stations
from .path import CLEARANCE_M, FreeSpace, handheld_path, walk
from .render import Renderer
from .room import furnished_room
from .scene import Scene
from .seen import SeenSurface
from .user_mesh import load_scene

BASELINE_M = 0.1
MIN_CORRIDOR_M, MAX_CORRIDOR_M = 5.0, 1000.0
_COLOR_NOISE = 1.2  # levels of 255, each eye on its own


@dataclass(frozen=True)
class Sensor:
    """A simulated sensor: its folder, the sentence that describes it, and a number that keeps its noise its own."""

    folder: str
    model: str
    stream: int


SENSORS = {
    "sl-handa": Sensor(
        "left_depth_noise_1.0", "structured light after Handa et al. 2014, random dot pattern, no lens distortion", 1
    ),
    "sl-habitat": Sensor(
        "left_depth_noise_1.0", "Redwood depth noise as in Habitat, multiplier 1, without its distortion table", 2
    ),
    "tof": Sensor("left_depth_noise_5.0", "time-of-flight-like model of this program: range noise, flying pixels", 3),
    "tof-habitat": Sensor(
        "left_depth_noise_5.0", "Redwood depth noise as in Habitat, multiplier 5, without its distortion table", 4
    ),
    "sgm": Sensor("left_sgm_depth", "OpenCV StereoSGBM on the rendered pair, left-right check, holes are 0", 5),
    "dense": Sensor(
        "left_dense_depth", "semi-global matching, filled, blurred across edges and biased; not a learned matcher", 6
    ),
}
_ALIASES = {"sl": "sl-handa"}
SENSOR_NAMES = ("sl", *SENSORS)


@dataclass(frozen=True)
class SynthOptions:
    """What `make_dataset` makes; the same options give the same files. Raises ConfigError if they are out of range.

    frames     number of images
    size_px    their width and height; the field of view is 90 degrees
    seed       of all random numbers
    mesh, up   the user's mesh instead of the synthetic room, and which of its axes ("z", "y") points up
    sensors    names of `SENSOR_NAMES`; true depth is always written
    loops      how often the path comes back to where it began
    corridor_m length of a corridor instead of the synthetic room, metres; the frames are spread evenly over it
    """

    frames: int = 130
    size_px: int = 384
    seed: int = 0
    mesh: Path | None = None
    up: str = "z"
    sensors: Sequence[str] = ("sl", "sgm")
    loops: int = 0
    corridor_m: float = 0.0

    def __post_init__(self) -> None:
        """Check the ranges."""
        if not 1 <= self.frames <= 100_000:
            raise ConfigError(f"frames must lie between 1 and 100000, not {self.frames}")
        if not 32 <= self.size_px <= 2048:
            raise ConfigError(f"the size must lie between 32 and 2048 pixels, not {self.size_px}")
        if self.loops < 0 or (self.loops and self.frames < 12 * self.loops + 1):
            least = 12 * max(self.loops, 0) + 1
            raise ConfigError(f"{self.loops} loops need at least {least} frames, not {self.frames}")
        if self.corridor_m and not MIN_CORRIDOR_M <= self.corridor_m <= MAX_CORRIDOR_M:
            raise ConfigError(f"a corridor is {MIN_CORRIDOR_M:g} to {MAX_CORRIDOR_M:g} m long, not {self.corridor_m:g}")
        if self.corridor_m and (self.mesh is not None or self.loops):
            raise ConfigError("a corridor can be combined neither with a mesh nor with loops")
        if self.up not in ("z", "y"):
            raise ConfigError(f"up must be z or y, not {self.up!r}")


def make_dataset(
    out: Path, options: SynthOptions | None = None, *, overwrite: bool = False, on_event: OnEvent = ignore
) -> Path:
    """Write a data set to `out` and return it. Raises ConfigError, DataError and RunError."""
    options = options or SynthOptions()
    frames, seed = options.frames, options.seed
    chosen = _chosen_sensors(options.sensors)
    out = Path(out)
    _check_free(out, overwrite)
    scene = _scene(options)
    camera = square_camera(options.size_px)
    on_event(Note(f"scene: {options.mesh if options.mesh is not None else ', '.join(scene.contents)}"))
    renderer = Renderer(scene, camera, np.random.default_rng([seed, 2]))
    poses = _path(options, renderer)
    _clear(out)
    recorder = _Recorder(out / "1", renderer, camera, chosen, seed)
    surface = SeenSurface(renderer)
    with ThreadPoolExecutor(max_workers=min(4, os.cpu_count() or 1)) as pool:
        try:
            for index in track_progress(
                pool.map(partial(_record, recorder, poses), range(frames)), frames, "synth", on_event
            ):
                surface.add(poses[index], camera)
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    surface.mesh().save(out / "mesh_gt.ply")
    facts = _facts(options, chosen, scene.contents)
    write_text(out / "synth.json", json.dumps(facts, indent=2) + "\n")  # last: it says that the data set is whole
    return out


def _scene(options: SynthOptions) -> Scene:
    if options.mesh is not None:
        return load_scene(options.mesh, options.up)
    return corridor(options.corridor_m, options.seed) if options.corridor_m else furnished_room(options.seed)


def _path(options: SynthOptions, renderer: Renderer) -> np.ndarray:
    """(F, 4, 4) T_world_camera of all frames."""
    rng = np.random.default_rng([options.seed, 3])
    if options.corridor_m:
        return walk(corridor_stations(options.corridor_m, rng), options.frames, rng)
    free = FreeSpace.find(renderer.raycaster, *renderer.scene.bounds)
    return handheld_path(free, options.frames, rng, options.loops)


def _record(recorder: _Recorder, poses: np.ndarray, index: int) -> int:
    recorder.record(index, poses[index])
    return index


class _Recorder:
    """Renders one frame and writes all its files. Frames do not depend on each other."""

    def __init__(self, folder: Path, renderer: Renderer, camera: Camera, sensors: Sequence[str], seed: int) -> None:
        self.folder, self.renderer, self.camera = folder, renderer, camera
        self.sensors, self.seed = sensors, seed
        self.fb = camera.fx * BASELINE_M
        self.bias = stereo.bias_field(camera.height, camera.width, np.random.default_rng([seed, 4]))

    def record(self, index: int, T_world_camera: np.ndarray) -> None:
        """Write frame `index`, seen from the pose (4, 4) of its left eye. Raises RunError."""
        right_pose = T_world_camera.copy()
        right_pose[:3, 3] += BASELINE_M * T_world_camera[:3, 0]
        left = self.renderer.render(T_world_camera)
        right = self.renderer.render(right_pose)
        rng = np.random.default_rng([self.seed, 5, index])
        images = [_noisy(view.color, rng) for view in (left, right)]
        for name, image in zip(("left_rgb", "right_rgb"), images, strict=True):
            write_image(self.folder / name / f"{index}.png", image)
        self._write_depth("left_depth_gt", index, left.depth)
        for name in self.sensors:
            self._write_depth(SENSORS[name].folder, index, self._sense(name, index, left.depth, images))
        matrix = pose_file_matrix(T_world_camera)
        rows = "\n".join(" ".join(f"{value:.9f}" for value in row) for row in matrix)
        write_text(self.folder / "left_camera_matrix" / f"{index}.txt", rows + "\n")

    def _sense(self, name: str, index: int, depth: np.ndarray, images: list[np.ndarray]) -> np.ndarray:
        left, right = images
        rng = np.random.default_rng([self.seed, 6, SENSORS[name].stream, index])
        match name:
            case "sl-handa":
                return active.structured_light_handa(depth, rng, self.camera.fx)
            case "sl-habitat":
                return active.structured_light_redwood(depth, rng)
            case "tof":
                return active.time_of_flight(depth, rng, self.camera.fx)
            case "tof-habitat":
                return active.structured_light_redwood(depth, rng, multiplier=5.0)
            case "sgm":
                return stereo.semi_global_matching(left, right, self.fb)
            case _:
                return stereo.dense_stereo(left, right, self.fb, self.bias)

    def _write_depth(self, folder: str, index: int, depth: np.ndarray) -> None:
        write_image(self.folder / folder / f"{index}.png", encode_metres(depth, DEPTH_UNITS_PER_M))


def square_camera(size: int) -> Camera:
    """The camera of the layout: 90 degrees about the middle of the image, `size` pixels wide and high."""
    return Camera(size, size, size / 2, size / 2, (size - 1) / 2, (size - 1) / 2)


def pose_file_matrix(T_world_camera: np.ndarray) -> np.ndarray:
    """(4, 4) as SenFuNet stores it: OpenGL camera axes in a world with y up. The inverse of what its reader does."""
    return Z_UP_FROM_Y_UP.T @ T_world_camera @ OPENGL_TO_OPENCV


def _noisy(color: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    noise = rng.standard_normal(color.shape, dtype=np.float32)
    return np.clip(color + _COLOR_NOISE * noise + 0.5, 0, 255).astype(np.uint8)


def _chosen_sensors(names: Sequence[str]) -> tuple[str, ...]:
    chosen: dict[str, str] = {}
    for name in names:
        resolved = _ALIASES.get(name, name)
        if resolved not in SENSORS:
            raise ConfigError(f"there is no simulated sensor {name!r}; choose from {', '.join(SENSOR_NAMES)}")
        other = chosen.setdefault(SENSORS[resolved].folder, resolved)
        if other != resolved:
            raise ConfigError(
                f"{other} and {resolved} are variants of one sensor and share a folder; choose one of them"
            )
    return tuple(chosen.values())


def _check_free(out: Path, overwrite: bool) -> None:
    if out.is_file():
        raise RunError(f"{out} is a file; name a new folder")
    if out.is_dir() and any(out.iterdir()) and not overwrite:
        raise RunError(f"{out} is not empty; name another folder, or give --overwrite to replace the data set in it")


def _clear(out: Path) -> None:
    """Remove an older data set and nothing else; `synth.json` first, because it calls the data set whole."""
    with explain_write_errors(out):
        for name in ("synth.json", "mesh_gt.ply"):
            (out / name).unlink(missing_ok=True)
        if (out / "1").exists():
            shutil.rmtree(out / "1")


def _facts(options: SynthOptions, chosen: Sequence[str], contents: Sequence[str]) -> dict[str, object]:
    mesh = options.mesh
    kind = "user mesh" if mesh is not None else "procedural corridor" if options.corridor_m else "procedural room"
    path = "walk with hand shake" if options.corridor_m else "spline through random waypoints with hand shake"
    return {
        "made_by": "uncle synth: rendered images and simulated sensors, not a recording",
        "layout": "SenFuNet-Replica",
        "parameters": {
            "frames": options.frames, "size_px": options.size_px, "seed": options.seed, "loops": options.loops,
            "mesh": str(mesh) if mesh is not None else None, "up": options.up,
            **({"corridor_m": options.corridor_m} if options.corridor_m else {}),
        },
        "scene": {"kind": kind, "contents": list(contents)},
        "camera": square_camera(options.size_px).to_dict() | {"stereo_baseline_m": BASELINE_M},
        "path": {"kind": path, "clearance_m": CLEARANCE_M},
        "color": {"noise_sigma_levels": _COLOR_NOISE, "shading": "diffuse; no highlights, no motion blur"},
        "sensors": {"left_depth_gt": "exact depth, rounded to millimetres"}
        | {SENSORS[name].folder: f"{name}: {SENSORS[name].model}" for name in chosen},
        "mesh_gt": "surface seen by at least one left image, triangles of 5 cm or less, z up",
    }  # fmt: skip
