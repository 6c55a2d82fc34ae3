"""Points of the scene that two frames show: features of the colour images, matched and checked by epipolar geometry.

Neither depth nor poses nor intrinsics are used, so that each of them can be judged by the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from torch import Tensor

from ...core.camera import Camera
from ...core.errors import DataError

GAPS = (1, 3, 8, 20)  # frames to the second frame of a pair
FEATURES = 700  # per frame
MAX_PIXELS = 200_000  # larger images are reduced before features are extracted
RATIO = 0.8  # Lowe's test: the best match against the second best
EPIPOLAR_PX = 1.0
MIN_MATCHES = 20  # a pair with fewer is not used
MATCHES_PER_PAIR = 100
SMOOTH = 1.1  # largest ratio of depths around a pixel whose depth is used


class InspectedFrames(Protocol):
    """What an inspection reads of a recording or of the frames of a run."""

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the depth sensors."""

    @property
    def camera(self) -> Camera:
        """The pinhole camera of all images."""

    def __len__(self) -> int: ...

    def timestamp(self, index: int) -> float:
        """Seconds."""

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera or None."""

    def color(self, index: int) -> Tensor:
        """(H, W, 3) uint8 RGB. Raises DataError."""

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement. Raises DataError."""


@dataclass(frozen=True)
class FrameInterval:
    """The frames `start` to `stop` (not included) of a recording, numbered from 0; implements `InspectedFrames`."""

    frames: InspectedFrames
    start: int
    stop: int

    @property
    def sensors(self) -> tuple[str, ...]:
        """As the recording has them."""
        return self.frames.sensors

    @property
    def camera(self) -> Camera:
        """The pinhole camera of all images."""
        return self.frames.camera

    def __len__(self) -> int:
        return self.stop - self.start

    def timestamp(self, index: int) -> float:
        """Seconds."""
        return self.frames.timestamp(self.start + index)

    def pose(self, index: int) -> np.ndarray | None:
        """(4, 4) T_world_camera or None."""
        return self.frames.pose(self.start + index)

    def color(self, index: int) -> Tensor:
        """(H, W, 3) uint8 RGB. Raises DataError."""
        return self.frames.color(self.start + index)

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement. Raises DataError."""
        return self.frames.depth(self.start + index, sensor)


@dataclass(frozen=True)
class Matches:
    """N pairs of pixels that show one point: frame indices `first`, `second` (N,), pixels (N, 2) as column and row."""

    first: np.ndarray
    second: np.ndarray
    pixels_first: np.ndarray
    pixels_second: np.ndarray

    def __len__(self) -> int:
        return len(self.first)

    def chosen(self, rows: np.ndarray) -> Matches:
        """The matches `rows`: positions, or (N,) bool."""
        return Matches(self.first[rows], self.second[rows], self.pixels_first[rows], self.pixels_second[rows])


@dataclass(frozen=True)
class _Features:
    pixels: np.ndarray  # (K, 2) of the full image
    descriptors: np.ndarray  # (K, 128)


def frame_pairs(count: int, anchors: int, gaps: Sequence[int] = GAPS) -> list[tuple[int, int]]:
    """Pairs of frame indices below `count`: `anchors` frames spread over the sequence, each with those `gaps` later."""
    first = np.unique(np.linspace(0, max(count - 2, 0), anchors).astype(int))
    return [(int(a), int(a) + gap) for a in first for gap in gaps if a + gap < count]


def find_matches(frames: InspectedFrames, pairs: Sequence[tuple[int, int]]) -> Matches:
    """Matches of all `pairs`; frames that cannot be read give none."""
    indices = sorted({index for pair in pairs for index in pair})
    with ThreadPoolExecutor(2) as pool:
        features = dict(zip(indices, pool.map(lambda index: _features(frames, index), indices), strict=True))
        found = list(pool.map(lambda pair: _match(features[pair[0]], features[pair[1]]), pairs))
    first, second = np.repeat(np.array(pairs, int).reshape(-1, 2), [len(pixels) for pixels in found], axis=0).T
    joined = np.concatenate([np.zeros((0, 2, 2)), *found])
    return Matches(first, second, joined[:, 0], joined[:, 1])


def depth_at(depth: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Median depth (N,) of the 3 x 3 pixels around `pixels` (N, 2); 0 at edges, holes and outside the image."""
    height, width = depth.shape
    column, row = np.rint(pixels).astype(int).T
    inside = (column > 0) & (row > 0) & (column < width - 1) & (row < height - 1)
    column, row = np.clip(column, 1, width - 2), np.clip(row, 1, height - 2)
    around = np.stack([depth[row + dy, column + dx] for dy in (-1, 0, 1) for dx in (-1, 0, 1)])
    lowest, highest = around.min(0), around.max(0)
    usable = inside & (lowest > 0) & (highest < SMOOTH * lowest)
    result: np.ndarray = np.where(usable, np.median(around, 0), 0.0)
    return result


def _features(frames: InspectedFrames, index: int) -> _Features:
    try:
        gray = cv2.cvtColor(frames.color(index).numpy(), cv2.COLOR_RGB2GRAY)
    except DataError:
        return _Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    reduction = min(1.0, (MAX_PIXELS / gray.size) ** 0.5)
    if reduction < 1.0:
        gray = cv2.resize(gray, None, fx=reduction, fy=reduction, interpolation=cv2.INTER_AREA)
    points, descriptors = cv2.SIFT.create(nfeatures=FEATURES).detectAndCompute(gray, None)
    if not points:
        return _Features(np.zeros((0, 2)), np.zeros((0, 128), np.float32))
    pixels = np.array([point.pt for point in points])
    return _Features((pixels + 0.5) / reduction - 0.5, descriptors)


def _match(first: _Features, second: _Features) -> np.ndarray:
    """(M, 2, 2) pixels in the first and in the second image."""
    none = np.zeros((0, 2, 2))
    if min(len(first.pixels), len(second.pixels)) < MIN_MATCHES:
        return none
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    forward = matcher.knnMatch(first.descriptors, second.descriptors, k=2)
    backward = {m.queryIdx: m.trainIdx for m in matcher.match(second.descriptors, first.descriptors)}
    rows = [
        (best.queryIdx, best.trainIdx)
        for best, other in forward
        if best.distance < RATIO * other.distance and backward[best.trainIdx] == best.queryIdx
    ]
    if len(rows) < MIN_MATCHES:
        return none
    pixels = np.stack([first.pixels[[a for a, _ in rows]], second.pixels[[b for _, b in rows]]], 1)
    try:
        found = cv2.findFundamentalMat(pixels[:, 0], pixels[:, 1], cv2.USAC_MAGSAC, EPIPOLAR_PX, 0.999, 2000)
    except cv2.error:  # no model fits
        return none
    inliers = pixels[np.asarray(found[1], bool).ravel()]
    if len(inliers) < MIN_MATCHES:
        return none
    keep = np.linspace(0, len(inliers) - 1, min(len(inliers), MATCHES_PER_PAIR)).astype(int)
    chosen: np.ndarray = inliers[keep]
    return chosen
