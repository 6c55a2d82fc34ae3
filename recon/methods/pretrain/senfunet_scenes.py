"""What SenFuNet learns from: depth, colour and poses of recordings beside the true signed distance, in one file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from ...core.camera import Camera
from ...core.errors import ConfigError, DataError
from ...core.events import OnEvent, ignore, track_progress
from ...core.files import DEPTH_UNITS_PER_M, atomic_path, encode_metres
from ...core.json_values import first_problem
from ...core.mesh import Mesh
from ...core.world_offset import NO_OFFSET
from .depth_pairs import TRUTH, load_arrays, packed, spread, unpacked
from .true_distance import TrueDistance

FORMAT = "uncle senfunet scenes"
COMMAND = "uncle pretrain senfunet --prepare"


@dataclass(frozen=True)
class Scene:
    """depths: sensor -> (N, H, W) uint16 millimetres; jpegs: N encoded colour images; T_world_camera (N, 4, 4)."""

    camera: Camera
    depths: dict[str, np.ndarray]
    jpegs: list[np.ndarray]
    T_world_camera: np.ndarray
    truth: TrueDistance

    def __len__(self) -> int:
        return len(self.T_world_camera)

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        """(H, W) float32 metres."""
        return torch.from_numpy(self.depths[sensor][index].astype(np.float32) / DEPTH_UNITS_PER_M)

    def color(self, index: int) -> torch.Tensor:
        """(H, W, 3) uint8 RGB."""
        jpeg = self.jpegs[index]
        image = cv2.imdecode(jpeg, cv2.IMREAD_COLOR) if len(jpeg) else None
        if image is None:
            raise DataError(
                f"colour image {index} of the training data cannot be decoded; make them again: `{COMMAND}`"
            )
        return torch.from_numpy(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))


def collect_scene(
    name: str, source: Any, sensors: Sequence[str], frames: int, voxel_size_m: float, truncation_voxels: int,
    on_event: OnEvent = ignore,
) -> Scene:  # fmt: skip
    """Up to `frames` evenly spread frames of a recording, or of the frames of a run. Raises ConfigError, DataError.

    It needs true depth, a reference mesh and poses: `uncle synth` makes all three.
    """
    missing = [sensor for sensor in (*sensors, TRUTH) if sensor not in source.sensors]
    if missing:
        raise ConfigError(f"{name} has no sensor {missing[0]!r}, only {', '.join(source.sensors)}")
    mesh = _reference_mesh(name, source)
    posed = [index for index in range(len(source)) if source.pose(index) is not None]
    chosen = [posed[at] for at in spread(len(posed), frames)] if posed else []
    if not chosen:
        raise DataError(f"{name}: no frame has a camera pose, and nothing can be learned without")
    depths: dict[str, list[np.ndarray]] = {sensor: [] for sensor in (*sensors, TRUTH)}
    jpegs = []
    for index in track_progress(chosen, len(chosen), f"reading {name}", on_event):
        for sensor, images in depths.items():
            images.append(encode_metres(source.depth(index, sensor).numpy(), DEPTH_UNITS_PER_M))
        bgr = cv2.cvtColor(source.color(index).numpy(), cv2.COLOR_RGB2BGR)
        jpegs.append(cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, 90])[1])
    poses = np.stack([source.pose(index) for index in chosen])
    true_depth = np.stack(depths.pop(TRUTH)).astype(np.float32) / DEPTH_UNITS_PER_M
    truth = TrueDistance.measure(mesh, source.camera, poses, true_depth, voxel_size_m, truncation_voxels, on_event)
    stacked = {sensor: np.stack(images) for sensor, images in depths.items()}
    return Scene(source.camera, stacked, jpegs, poses, truth)


def save_scenes(path: Path, scenes: Sequence[Scene]) -> None:
    """One compressed file. Raises RunError."""
    arrays: dict[str, Any] = {"format": FORMAT, "scenes": len(scenes), "sensors": list(scenes[0].depths)}
    for number, scene in enumerate(scenes):
        key = f"{number}_"
        arrays |= {key + sensor: packed(images) for sensor, images in scene.depths.items()}
        arrays[key + "jpegs"] = np.concatenate(scene.jpegs)
        arrays[key + "jpeg_sizes"] = np.array([len(jpeg) for jpeg in scene.jpegs])
        arrays[key + "poses"], arrays[key + "camera"] = scene.T_world_camera, np.array([*vars(scene.camera).values()])
        arrays |= {key + name: values for name, values in scene.truth.arrays().items()}
    with atomic_path(path) as temporary, open(temporary, "wb") as file:
        np.savez_compressed(file, **arrays)


def load_scenes(path: Path) -> list[Scene]:
    """Raises DataError."""
    arrays = load_arrays(path, FORMAT, COMMAND)
    try:
        return [_scene(arrays, f"{number}_") for number in range(int(arrays["scenes"]))]
    except KeyError as error:
        raise DataError(f"{path}: {error} is missing; make it again with `{COMMAND}`") from error
    except (ValueError, TypeError, IndexError, OverflowError) as error:
        raise DataError(f"{path} is damaged ({first_problem(error)}); make it again with `{COMMAND}`") from error


def _scene(arrays: dict[str, np.ndarray], key: str) -> Scene:
    width, height, *pinhole = arrays[key + "camera"].astype(float).tolist()
    depths = {sensor: unpacked(arrays[key + sensor]) for sensor in arrays["sensors"].tolist()}
    sizes = arrays[key + "jpeg_sizes"]
    if sizes.dtype.kind not in "iu":
        raise ValueError(f"its sizes of images are {sizes.dtype}, not whole numbers")
    poses, bounds = arrays[key + "poses"].astype(float), np.cumsum(sizes.astype(np.int64))
    jpegs = np.split(arrays[key + "jpegs"], bounds[:-1])
    camera = Camera(int(width), int(height), *pinhole)
    expected = {(len(jpegs), camera.height, camera.width)}
    is_image = arrays[key + "jpegs"].dtype == np.uint8 and arrays[key + "jpegs"].ndim == 1
    if not is_image or {images.shape for images in depths.values()} != expected or poses.shape != (len(jpegs), 4, 4):
        raise ValueError(f"its arrays are not those of {len(jpegs)} frames of {camera.width}x{camera.height}")
    return Scene(camera, depths, jpegs, poses, TrueDistance.from_arrays(arrays, key))


def _reference_mesh(name: str, source: Any) -> Mesh:
    path = getattr(source, "reference_mesh", None)
    if path is None and hasattr(source, "run"):
        path = source.run.load_manifest().reference_mesh
    if path is None:
        raise DataError(
            f"{name} has no reference mesh, and the true distances are measured to one; `uncle synth` makes one"
        )
    return Mesh.load(Path(path), offset_m=NO_OFFSET)
