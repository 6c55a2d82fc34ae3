"""Reading the preprocessed frames of a run."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.compiled import compiled
from ..core.errors import DataError, RunError
from ..core.files import BETA_UNITS_PER_M, DEPTH_UNITS_PER_M, read_image, read_json
from ..core.frame import Frame
from ..core.json_values import first_problem
from .directory import RunDirectory
from .manifest import FrameRecord

T = TypeVar("T")


class RunFrames:
    """The frames of a run, in order; index = position. `sensors` limits what is read."""

    def __init__(self, run: RunDirectory, sensors: Sequence[str] | None = None) -> None:
        manifest = run.load_manifest()
        run.require_stage("preprocess")
        self.run = run
        self.camera: Camera = manifest.pinhole_camera()
        self.registration_sigma_px = manifest.registration_sigma_px
        self.sensors: tuple[str, ...] = tuple(sensors) if sensors is not None else manifest.sensors
        try:
            self.records = [FrameRecord.model_validate(row) for row in read_json(run.frames_path)]
        except (OSError, ValueError, TypeError) as error:
            raise RunError(
                f"cannot read {run.frames_path}: {first_problem(error)}; redo it with `uncle preprocess --overwrite`"
            ) from error

    def __len__(self) -> int:
        return len(self.records)

    @property
    def has_poses(self) -> bool:
        """Whether every frame has a pose."""
        return all(record.T_world_camera is not None for record in self.records)

    def timestamp(self, index: int) -> float:
        """Seconds, or the index of the frame where the recording has no clock."""
        return self.records[index].timestamp

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera or None."""
        matrix = self.records[index].T_world_camera
        return None if matrix is None else np.array(matrix)

    def known_pose(self, index: int) -> np.ndarray:
        """(4, 4) T_world_camera. Raises DataError if the frame has none."""
        pose = self.pose(index)
        if pose is None:
            raise DataError(f"frame {index} of {self.run.root} has no camera pose; choose frames that have one")
        return pose

    def color(self, index: int) -> Tensor:
        """(H, W, 3) uint8 RGB. Raises DataError."""
        image = self._image(self.run.color_path(self.records[index].color), cv2.IMREAD_COLOR, 3)
        return torch.from_numpy(image)

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement; all 0 if the sensor has no image here. Raises DataError."""
        if sensor not in self.records[index].sensors:
            return torch.zeros(self.camera.height, self.camera.width)
        image = self._image(self.run.depth_path(sensor, index), cv2.IMREAD_UNCHANGED)
        return torch.from_numpy(image.astype(np.float32) / DEPTH_UNITS_PER_M)

    def normals(self, index: int, sensor: str) -> Tensor:
        """(H, W, 3) float32 unit normals in camera axes, towards the camera; 0 where unknown. Raises DataError."""
        if sensor not in self.records[index].sensors:
            return torch.zeros(self.camera.height, self.camera.width, 3)
        return decode_normals(self._image(self.run.normal_path(sensor, index), cv2.IMREAD_COLOR, 3))

    def beta(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 Laplace scale in metres, 0 where there is no measurement. Raises DataError."""
        image = self._image(self.run.beta_path(sensor, index), cv2.IMREAD_UNCHANGED)
        return torch.from_numpy(image.astype(np.float32) / BETA_UNITS_PER_M)

    def _image(self, path: Path, flags: int, *channels: int) -> np.ndarray:
        """(H, W, *channels) of the camera's size. Raises DataError."""
        image = read_image(path, flags)
        if image.shape != (self.camera.height, self.camera.width, *channels):
            raise DataError(
                f"{path} is not an image of this run: expected {self.camera.width}x{self.camera.height}, found "
                f"{image.shape}; redo it with `uncle preprocess --overwrite`"
            )
        return image

    def __getitem__(self, index: int) -> Frame:
        record = self.records[index]
        depths = {sensor: self.depth(index, sensor) for sensor in self.sensors}
        return Frame(index, record.timestamp, self.color(index), depths, self.pose(index))

    def stream(self, indices: Sequence[int], prepare: Callable[[Frame], T], ahead: int = 4) -> Iterator[T]:
        """Yield `prepare(frame)` of each frame, while the next `ahead` are read and prepared in the background."""
        with ThreadPoolExecutor(max_workers=1) as pool:
            pending = deque(pool.submit(self._prepared, index, prepare) for index in indices[:ahead])
            for position in range(len(indices)):
                ready = pending.popleft().result()
                if position + ahead < len(indices):
                    pending.append(pool.submit(self._prepared, indices[position + ahead], prepare))
                yield ready

    def _prepared(self, index: int, prepare: Callable[[Frame], T]) -> T:
        return prepare(self[index])


def encode_normals(normals: np.ndarray) -> np.ndarray:
    """(H, W, 3) unit vectors, 0 = unknown -> uint8 picture; unknown stays black."""
    known = (normals[..., :1] != 0) | (normals[..., 1:2] != 0) | (normals[..., 2:] != 0)
    picture: np.ndarray = (normals * np.float32(127.0) + np.float32(128.5)).astype(np.uint8) * known
    return picture


def decode_normals(image: np.ndarray) -> Tensor:
    """(H, W, 3) float32 unit normals, 0 = unknown, of a picture by `encode_normals`; off by 0.5 degrees at most."""
    normals = np.empty(image.shape, np.float32)
    _decode(image.reshape(-1, 3), normals.reshape(-1, 3))
    return torch.from_numpy(normals)


@compiled()
def _decode(picture: np.ndarray, normals: np.ndarray) -> None:
    for pixel in range(len(picture)):
        known = np.float32(picture[pixel, 0] != 0)  # every channel of a known normal is at least 1
        x = np.float32(picture[pixel, 0]) - np.float32(128)
        y = np.float32(picture[pixel, 1]) - np.float32(128)
        z = np.float32(picture[pixel, 2]) - np.float32(128)
        scale = known / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-6))
        normals[pixel, 0], normals[pixel, 1], normals[pixel, 2] = x * scale, y * scale, z * scale
