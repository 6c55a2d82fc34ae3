"""Which sensor can be believed in which frame: dropped out, frozen, or suddenly at odds with the map.

Judged frame by frame while exploring, before anything of the frame is fused. So the map that a sensor is compared with
was made of what was believed until then, and one that goes wrong cannot pull it over to its side.
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

SAMPLES = 700  # rays of a frame that are compared with the map: the median of so many is known well enough
MIN_COMPARED_MEASUREMENTS = 70  # readings that meet the map: with fewer the verdict before stands
HISTORY = 60  # frames back that say what is usual of a sensor
MIN_HISTORY = 5  # frames before anything is called unusual
SCATTER_TIMES = 4.0  # the usual scatter is unusual
_STRIDE = 4  # pixels: an image is recognised by a part of them
_SAME_M = 1.1e-3  # depth is stored in millimetres
_SAME_SHARE = 0.99  # of the readings repeat: the image is the same one
_TELLING_SHARE = 0.9  # an image that is that much like itself moved by a few pixels cannot tell
_MOVED_PX = 1.0  # of the image, by the poses
_MOVED_GREY = 1.5  # mean change of a thumbnail, in levels of 255


@dataclass(frozen=True)
class Comparison:
    """The relative errors (D - D_map) / D_map of one sensor in one frame: median, median deviation, their number."""

    bias: float
    scatter: float
    count: int


@dataclass(frozen=True)
class Appearance:
    """An image of a sensor when it was first seen, thinned out: depth (h, w) metres; with a thumbnail of the colour
    (h', w') and T_world_camera (4, 4), or nothing, at that time."""

    depth: Tensor
    thumbnail: Tensor
    T_world_camera: Tensor | None


@dataclass
class _Past:
    """What is usual of a sensor, from the latest frames that were believed; `last` is the verdict by the map before."""

    seen: list[float] = field(default_factory=list)  # share of the pixels with a reading
    biases: list[float] = field(default_factory=list)
    scatters: list[float] = field(default_factory=list)
    last: Verdict = "ok"


class FaultDetector:
    """Judges the sensors of frame after frame and remembers every verdict.

    `poses_given`: those of the recording count as true; else a frame may be off because its pose is.
    """

    def __init__(
        self, camera: Camera, sensors: tuple[str, ...], config: FaultDetectionConfig, poses_given: bool
    ) -> None:
        self.camera, self.sensors, self.config, self.poses_given = camera, sensors, config, poses_given
        self.verdicts: dict[str, dict[int, Verdict]] = {sensor: {} for sensor in sensors}
        self._past = {sensor: _Past() for sensor in sensors}
        self._appearances: dict[str, Appearance] = {}
        stride = max(1, round((camera.width * camera.height / SAMPLES) ** 0.5))
        self._grid = (slice(stride // 2, None, stride), slice(stride // 2, None, stride))

    @property
    def rays(self) -> Tensor:
        """(N, 3) directions in camera axes (`Camera.rays`) that `check_against_map` compares with the map."""
        return self.camera.rays()[self._grid].reshape(-1, 3)

    def check_images(self, frame: Frame) -> Frame:
        """Judge a frame by its images alone; returns it without the sensors that are missing or frozen."""
        if not self.config.enabled:
            return frame
        thumbnail = _thumbnail(frame.color)
        for sensor, depth in frame.depths.items():
            self.verdicts[sensor][frame.index] = self._check_image(frame, sensor, depth, thumbnail)
        return self.without_faulty(frame)

    def check_against_map(self, frame: Frame, predicted: Tensor, max_depth_m: float) -> Frame:
        """Judge a frame that was looked at by `predicted` (N,), the z-depth of the map on `rays` in metres, 0 = none.

        A sensor is at fault if it is off the map by more than it ever was. If all of several sensors are, the pose or
        the scene is to blame, and if the pose was estimated by the only one that sees, nobody can tell.
        """
        if not self.config.enabled:
            return frame
        errors = {s: compare_depths(d[self._grid].reshape(-1), predicted, max_depth_m) for s, d in frame.depths.items()}
        judged = {s: e for s, e in errors.items() if e.count >= MIN_COMPARED_MEASUREMENTS}
        off = {s for s, e in judged.items() if is_unusual(e, self._past[s].biases, self._past[s].scatters, self.config)}
        nobody_agrees = off == set(judged) and (len(judged) > 1 or not self.poses_given)
        for sensor in frame.depths:
            past = self._past[sensor]
            if sensor in judged and not (sensor in off and nobody_agrees):
                past.last = "inconsistent" if sensor in off else "ok"
            if self.verdicts[sensor][frame.index] != "ok":
                continue
            self.verdicts[sensor][frame.index] = past.last
            if sensor in judged and sensor not in off:
                past.biases = [*past.biases, judged[sensor].bias][-HISTORY:]
                past.scatters = [*past.scatters, judged[sensor].scatter][-HISTORY:]
        return self.without_faulty(frame)

    def without_suspected(self, frame: Frame) -> Frame:
        """A frame that was looked at, without the sensors that disagreed last, unless no other sees anything."""
        suspects = [s for s, past in self._past.items() if past.last == "inconsistent"]
        kept = _without(frame, suspects)
        return kept if any(bool((depth > 0).any()) for depth in kept.depths.values()) else frame

    def without_faulty(self, frame: Frame) -> Frame:
        """The frame with no reading from the sensors that are at fault in it, as far as was judged."""
        return _without(frame, [s for s in frame.depths if self.verdicts[s].get(frame.index, "ok") != "ok"])

    def _check_image(self, frame: Frame, sensor: str, depth: Tensor, thumbnail: Tensor) -> Verdict:
        past, seen = self._past[sensor], float((depth > 0).float().mean())
        if seen <= self.config.min_valid_ratio * float(np.median(past.seen or [0.0])):
            return "missing"
        thin = depth[::_STRIDE, ::_STRIDE].clone()
        first = self._appearances.get(sensor)
        if first is None or not repeats(thin, first.depth):
            pose = frame.T_world_camera if self.poses_given else None
            pose = None if pose is None else torch.as_tensor(pose, dtype=torch.float64)
            self._appearances[sensor] = Appearance(thin, thumbnail, pose)
        elif self._moved(frame, first, thumbnail):
            return "frozen"
        past.seen = [*past.seen, seen][-HISTORY:]
        return "ok"

    def _moved(self, frame: Frame, first: Appearance, thumbnail: Tensor) -> bool:
        """Whether the camera is elsewhere than when an image was first seen."""
        if float((thumbnail - first.thumbnail).abs().mean()) > _MOVED_GREY:
            return True
        if first.T_world_camera is None or frame.T_world_camera is None:
            return False
        depth = float(first.depth[first.depth > 0].median())
        return image_motion(first.T_world_camera.numpy(), frame.T_world_camera, depth, self.camera) > _MOVED_PX

    # --- checkpoint --------------------------------------------------------------------------------------------
    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {
            "verdicts": {sensor: dict(verdicts) for sensor, verdicts in self.verdicts.items()},
            "past": {sensor: dict(vars(past)) for sensor, past in self._past.items()},
            "appearances": {sensor: dict(vars(first)) for sensor, first in self._appearances.items()},
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self.verdicts = {sensor: dict(verdicts) for sensor, verdicts in state["verdicts"].items()}
        self._past = {sensor: _Past(**past) for sensor, past in state["past"].items()}
        self._appearances = {sensor: Appearance(**first) for sensor, first in state["appearances"].items()}


def compare_depths(depth: Tensor, predicted: Tensor, max_depth_m: float) -> Comparison:
    """depth (N,) and predicted (N,) metres, 0 = none -> their relative difference, robustly."""
    used = (depth > 0) & (depth < max_depth_m) & (predicted > 0)
    if not bool(used.any()):
        return Comparison(0.0, 0.0, 0)
    errors = ((depth[used] - predicted[used]) / predicted[used]).numpy()
    bias = float(np.median(errors))
    return Comparison(bias, float(np.median(np.abs(errors - bias))), len(errors))


def is_unusual(now: Comparison, biases: list[float], scatters: list[float], config: FaultDetectionConfig) -> bool:
    """Whether a frame is off as none of those before it was: beyond all their biases, or far more scattered.

    All of them and not their spread: the bias of a sensor wanders with the depth that it sees, and a fault is a jump.
    """
    if len(biases) < MIN_HISTORY:
        return False
    if not min(biases) - config.max_median_shift < now.bias < max(biases) + config.max_median_shift:
        return True
    return now.scatter > max(config.max_mad, SCATTER_TIMES * float(np.median(scatters)))


def repeats(depth: Tensor, earlier: Tensor) -> bool:
    """Whether an image (h, w) metres is an earlier one again. One without any structure cannot tell."""
    if _same_share(depth, earlier) < _SAME_SHARE:
        return False
    return min(_same_share(depth[1:], depth[:-1]), _same_share(depth[:, 1:], depth[:, :-1])) < _TELLING_SHARE


def image_motion(first: np.ndarray, second: np.ndarray, depth_m: float, camera: Camera) -> float:
    """About how many pixels the image at `depth_m` moves between two T_world_camera (4, 4)."""
    step = np.linalg.inv(first) @ second
    angle = float(rotation_angle(step))
    return camera.max_focal_px * (angle + float(np.linalg.norm(step[:3, 3])) / depth_m)


def _same_share(first: Tensor, second: Tensor) -> float:
    """Share of the pixels with a reading in either image whose readings are the same."""
    either = (first > 0) | (second > 0)
    return float(((first - second).abs() < _SAME_M)[either].float().mean()) if bool(either.any()) else 1.0


def _thumbnail(color: Tensor) -> Tensor:
    """(H, W, 3) uint8 -> about (H / 8, W / 8) mean grey: what is left has no noise and no artefacts of compression."""
    grey = cv2.cvtColor(color.numpy(), cv2.COLOR_RGB2GRAY)
    size = (max(1, grey.shape[1] // 8), max(1, grey.shape[0] // 8))
    return torch.from_numpy(cv2.resize(grey.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def _without(frame: Frame, sensors: list[str]) -> Frame:
    if not sensors:
        return frame
    silent: Mapping[str, Tensor] = {s: torch.zeros_like(frame.depths[s]) for s in sensors}
    return replace(frame, depths=frame.depths | silent)
