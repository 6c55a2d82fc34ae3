"""Detection of sensor faults: frames in which a sensor drops out, freezes or suddenly disagrees with the map.

Every frame is checked in the online pass before any of it is fused. The map that a sensor is compared with was thus
made of measurements that passed, and a failing sensor cannot pull it to its own side.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import cv2
import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import FaultDetectionConfig
from ..core.frame import Frame
from ..core.se3 import rotation_angle

Verdict = Literal["ok", "missing", "frozen", "inconsistent"]


@dataclass(frozen=True)
class FaultDetectionParameters:
    """Constants of the detection, besides its settings.

    samples                    pixels of a frame that are compared with the map, about
    min_compared_measurements  of them with a measurement and a surface of the map; with fewer, the last verdict stands
    history                    latest frames that define what is usual of a sensor
    min_history                frames before anything counts as unusual
    max_mad_ratio              a median absolute deviation is unusual above this multiple of its median so far
    stride_px                  an image is recognised by every such pixel
    same_depth_m               depths that differ by less are the same: depth is stored in millimetres
    same_ratio                 of the measurements that must be the same for an image to be repeated
    max_self_similarity        an image that agrees more than this with itself shifted by a pixel is not recognised
    min_motion_px              motion of the image, by the poses, above which the camera has moved
    min_grey_change            mean change of a thumbnail, in levels of 255, above which the camera has moved
    """

    samples: int = 700
    min_compared_measurements: int = 70
    history: int = 60
    min_history: int = 5
    max_mad_ratio: float = 4.0
    stride_px: int = 4
    same_depth_m: float = 1.1e-3
    same_ratio: float = 0.99
    max_self_similarity: float = 0.9
    min_motion_px: float = 1.0
    min_grey_change: float = 1.5


PARAMETERS = FaultDetectionParameters()


@dataclass(frozen=True)
class Comparison:
    """Relative errors (D - D_map) / D_map of one sensor in one frame: median, median absolute deviation, number."""

    median: float
    mad: float
    count: int


@dataclass(frozen=True)
class FirstAppearance:
    """A depth image when it was first seen, to recognise a frozen sensor.

    depth (h, w) metres, thinned; thumbnail (h', w') grey of the colour; T_world_camera (4, 4), or None if unknown.
    """

    depth: Tensor
    thumbnail: Tensor
    T_world_camera: Tensor | None


@dataclass
class _History:
    """What is usual of a sensor, from its latest frames without a fault; `last` is the latest verdict by the map."""

    valid_ratios: list[float] = field(default_factory=list)
    medians: list[float] = field(default_factory=list)
    mads: list[float] = field(default_factory=list)
    last: Verdict = "ok"


class FaultDetector:
    """Checks the sensors of one frame after another, and keeps every verdict by sensor and frame index.

    `poses_given`: the poses are those of the recording and count as true; otherwise a frame may disagree with the map
    because its estimated pose is wrong.
    """

    def __init__(
        self,
        camera: Camera,
        sensors: tuple[str, ...],
        config: FaultDetectionConfig,
        poses_given: bool,
        parameters: FaultDetectionParameters = PARAMETERS,
    ) -> None:
        self.camera, self.sensors, self.config, self.poses_given = camera, sensors, config, poses_given
        self.parameters = parameters
        self.verdicts: dict[str, dict[int, Verdict]] = {sensor: {} for sensor in sensors}
        self._history = {sensor: _History() for sensor in sensors}
        self._appearances: dict[str, FirstAppearance] = {}
        stride = max(1, round((camera.width * camera.height / parameters.samples) ** 0.5))
        self._grid = (slice(stride // 2, None, stride), slice(stride // 2, None, stride))

    @property
    def rays(self) -> Tensor:
        """(N, 3) directions in camera axes (`Camera.rays`) that `check_against_map` compares with the map."""
        return self.camera.rays()[self._grid].reshape(-1, 3)

    @property
    def suspected(self) -> list[str]:
        """The sensors that were inconsistent when they were last compared with the map."""
        return [sensor for sensor, history in self._history.items() if history.last == "inconsistent"]

    def check_images(self, frame: Frame) -> Frame:
        """Check a frame by its images alone; returns it without the sensors that are missing or frozen."""
        if not self.config.enabled:
            return frame
        thumbnail = _thumbnail(frame.color)
        for sensor, depth in frame.depths.items():
            self.verdicts[sensor][frame.index] = self._check_image(frame, sensor, depth, thumbnail)
        return self.without_faulty(frame)

    def check_against_map(self, frame: Frame, predicted: Tensor, max_depth_m: float) -> Frame:
        """Check a frame, after `check_images`, by the map; returns it without the sensors that are inconsistent.

        `predicted` (N,) is the z-depth of the map on `rays`, metres, 0 = no surface. A sensor is inconsistent if its
        error against the map is unusual of it. If those of all of several sensors are, the pose or the scene may be the
        cause; and so if the pose was estimated and there is one sensor only. Then the last verdict stands.
        """
        if not self.config.enabled:
            return frame
        errors = {s: compare_depths(d[self._grid].reshape(-1), predicted, max_depth_m) for s, d in frame.depths.items()}
        compared = {s: e for s, e in errors.items() if e.count >= self.parameters.min_compared_measurements}
        unusual = {s for s, error in compared.items() if self._is_unusual(s, error)}
        undecided = unusual == set(compared) and (len(compared) > 1 or not self.poses_given)
        for sensor in frame.depths:
            history = self._history[sensor]
            if sensor in compared and not (sensor in unusual and undecided):
                history.last = "inconsistent" if sensor in unusual else "ok"
            if self.verdicts[sensor][frame.index] != "ok":
                continue
            self.verdicts[sensor][frame.index] = history.last
            if sensor in compared and sensor not in unusual:
                history.medians = self._append(history.medians, compared[sensor].median)
                history.mads = self._append(history.mads, compared[sensor].mad)
        return self.without_faulty(frame)

    def without_suspected(self, frame: Frame) -> Frame:
        """A checked frame without the `suspected` sensors, unless no other sensor measures anything."""
        remaining = _without(frame, self.suspected)
        return remaining if any(bool((depth > 0).any()) for depth in remaining.depths.values()) else frame

    def without_faulty(self, frame: Frame) -> Frame:
        """The frame with the depth of the sensors set to 0 that have a fault in it, as far as was checked."""
        return _without(frame, [s for s in frame.depths if self.verdicts[s].get(frame.index, "ok") != "ok"])

    def _is_unusual(self, sensor: str, error: Comparison) -> bool:
        history = self._history[sensor]
        return is_unusual(error, history.medians, history.mads, self.config, self.parameters)

    def _append(self, values: list[float], value: float) -> list[float]:
        return [*values, value][-self.parameters.history :]

    def _check_image(self, frame: Frame, sensor: str, depth: Tensor, thumbnail: Tensor) -> Verdict:
        history, valid_ratio = self._history[sensor], float((depth > 0).float().mean())
        usual_ratio = float(np.median(history.valid_ratios or [0.0]))
        if valid_ratio <= self.config.min_valid_ratio * usual_ratio:
            return "missing"
        stride = self.parameters.stride_px
        thinned = depth[::stride, ::stride].clone()
        first = self._appearances.get(sensor)
        if first is None or not repeats(thinned, first.depth, self.parameters):
            pose = frame.T_world_camera if self.poses_given else None
            stored = None if pose is None else torch.as_tensor(pose, dtype=torch.float64)
            self._appearances[sensor] = FirstAppearance(thinned, thumbnail, stored)
        elif self._camera_moved(frame, first, thumbnail):
            return "frozen"
        history.valid_ratios = self._append(history.valid_ratios, valid_ratio)
        return "ok"

    def _camera_moved(self, frame: Frame, first: FirstAppearance, thumbnail: Tensor) -> bool:
        """Whether the camera is no longer where it was when an image was first seen."""
        if float((thumbnail - first.thumbnail).abs().mean()) > self.parameters.min_grey_change:
            return True
        if first.T_world_camera is None or frame.T_world_camera is None:
            return False
        depth_m = float(first.depth[first.depth > 0].median())
        motion_px = image_motion(first.T_world_camera.numpy(), frame.T_world_camera, depth_m, self.camera)
        return motion_px > self.parameters.min_motion_px

    # --- checkpoint --------------------------------------------------------------------------------------------
    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {
            "verdicts": {sensor: dict(verdicts) for sensor, verdicts in self.verdicts.items()},
            "history": {sensor: dict(vars(history)) for sensor, history in self._history.items()},
            "appearances": {sensor: dict(vars(first)) for sensor, first in self._appearances.items()},
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from what `state_dict` returned."""
        self.verdicts = {sensor: dict(verdicts) for sensor, verdicts in state["verdicts"].items()}
        self._history = {sensor: _History(**history) for sensor, history in state["history"].items()}
        self._appearances = {sensor: FirstAppearance(**first) for sensor, first in state["appearances"].items()}


def compare_depths(depth: Tensor, predicted: Tensor, max_depth_m: float) -> Comparison:
    """depth (N,) and predicted (N,) metres, 0 = none -> robust statistics of their relative difference."""
    used = (depth > 0) & (depth < max_depth_m) & (predicted > 0)
    if not bool(used.any()):
        return Comparison(0.0, 0.0, 0)
    errors = ((depth[used] - predicted[used]) / predicted[used]).numpy()
    median = float(np.median(errors))
    return Comparison(median, float(np.median(np.abs(errors - median))), len(errors))


def is_unusual(
    error: Comparison,
    medians: list[float],
    mads: list[float],
    config: FaultDetectionConfig,
    parameters: FaultDetectionParameters = PARAMETERS,
) -> bool:
    """Whether the error of a frame is beyond all `medians` of the frames before it, or far more scattered.

    Compared with the range of the medians and not with their spread: the bias of a sensor changes slowly with the
    depth that it sees, and a fault is a jump.
    """
    if len(medians) < parameters.min_history:
        return False
    if not min(medians) - config.max_median_shift < error.median < max(medians) + config.max_median_shift:
        return True
    return error.mad > max(config.max_mad, parameters.max_mad_ratio * float(np.median(mads)))


def repeats(depth: Tensor, earlier: Tensor, parameters: FaultDetectionParameters = PARAMETERS) -> bool:
    """Whether an image (h, w) metres is an earlier one again. False for images without structure."""
    limit_m = parameters.same_depth_m
    if _same_ratio(depth, earlier, limit_m) < parameters.same_ratio:
        return False
    shifted = (_same_ratio(depth[1:], depth[:-1], limit_m), _same_ratio(depth[:, 1:], depth[:, :-1], limit_m))
    return min(shifted) < parameters.max_self_similarity


def image_motion(first: np.ndarray, second: np.ndarray, depth_m: float, camera: Camera) -> float:
    """About how many pixels the image of a surface at `depth_m` moves between two T_world_camera (4, 4)."""
    step = np.linalg.inv(first) @ second
    return camera.max_focal_px * (float(rotation_angle(step)) + float(np.linalg.norm(step[:3, 3])) / depth_m)


def _same_ratio(first: Tensor, second: Tensor, limit_m: float) -> float:
    """Of the pixels with a measurement in either image: how many differ by less than `limit_m`, 0..1."""
    either = (first > 0) | (second > 0)
    return float(((first - second).abs() < limit_m)[either].float().mean()) if bool(either.any()) else 1.0


def _thumbnail(color: Tensor) -> Tensor:
    """(H, W, 3) uint8 -> about (H / 8, W / 8) mean grey, free of noise and compression artefacts."""
    grey = cv2.cvtColor(color.numpy(), cv2.COLOR_RGB2GRAY)
    size = (max(1, grey.shape[1] // 8), max(1, grey.shape[0] // 8))
    return torch.from_numpy(cv2.resize(grey.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def _without(frame: Frame, sensors: list[str]) -> Frame:
    """The frame with the depth of some sensors set to 0."""
    if not sensors:
        return frame
    empty = {sensor: torch.zeros_like(frame.depths[sensor]) for sensor in sensors}
    return replace(frame, depths=frame.depths | empty)
