"""Points of an image that are found again in another one: SIFT with square-root descriptors (Arandjelovic 2012)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..core.camera import Camera
from ..core.se3 import inverse, transform

MAX_FEATURES = 1000
_PIXELS = 160_000
_CONTRAST = 0.02  # half of OpenCV's own threshold: plain walls have little
_RATIO = 0.85  # of squared distances best / second best; beyond it a match is ambiguous


@dataclass(frozen=True)
class LocalFeatures:
    """uv (N, 2) float64 pixels; sigma_px (N,) how far off that is; descriptors (N, 128) float32 of length 1."""

    uv: np.ndarray
    sigma_px: np.ndarray
    descriptors: np.ndarray

    def __len__(self) -> int:
        return len(self.uv)


def extract_features(color: np.ndarray, count: int = MAX_FEATURES) -> LocalFeatures:
    """color (H, W, 3) uint8 RGB -> at most about `count` features, the strongest; none in an image without texture."""
    grey, step = _shrunk(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY))
    sift = cv2.SIFT.create(count, 3, _CONTRAST, 10, 1.6, enable_precise_upscale=True)
    keypoints, descriptors = sift.detectAndCompute(grey, None)
    if not keypoints:
        return no_features()
    uv, kept = np.unique(np.array([k.pt for k in keypoints]), axis=0, return_index=True)  # one of several orientations
    sizes = np.array([keypoints[i].size for i in kept])
    descriptors = descriptors[kept]
    descriptors = np.sqrt(descriptors / np.maximum(descriptors.sum(1, keepdims=True), 1e-9))
    return LocalFeatures((uv + 0.5) * step - 0.5, (0.4 + 0.08 * sizes) * step, descriptors)


def _shrunk(grey: np.ndarray) -> tuple[np.ndarray, int]:
    """(H, W) at most `_PIXELS` large, each pixel the mean of `step` x `step`; and the step.

    SIFT doubles the image before anything else: of a large one from a camera that finds little but noise.
    """
    step = max(1, math.ceil(math.sqrt(grey.size / _PIXELS)))
    height, width = grey.shape[0] // step, grey.shape[1] // step
    whole = grey[: height * step, : width * step]
    return (cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA) if step > 1 else grey), step


def no_features() -> LocalFeatures:
    """Of an image without texture, or one that is not looked at."""
    return LocalFeatures(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 128), np.float32))


def match(similarity: np.ndarray) -> np.ndarray:
    """(M, 2) pairs of rows and columns of `similarity` (N, K), cosines of descriptors, that choose each other.

    A pair is left out if its row likes a second column nearly as much (Lowe 2004).
    """
    if min(similarity.shape) < 2:
        return np.zeros((0, 2), np.int64)
    rows = np.arange(len(similarity))
    best = similarity.argmax(1)
    mutual = similarity.argmax(0)[best] == rows
    top = similarity[rows, best]
    others = similarity.copy()
    others[rows, best] = -np.inf
    second = others.max(1)
    distinct = (1 - top) < _RATIO * (1 - second)
    kept = mutual & distinct
    return np.column_stack([rows[kept], best[kept]])


def match_near(similarity: np.ndarray, candidates: np.ndarray, threshold: float = 0.75) -> np.ndarray:
    """(M, 2) pairs among `candidates` (C, 2) that choose each other, if at least `threshold` alike."""
    alike = similarity[candidates[:, 0], candidates[:, 1]]
    order = np.argsort(-alike[alike > threshold], kind="stable")
    best = candidates[alike > threshold][order]
    first_of_row = np.zeros(len(best), bool)
    first_of_column = first_of_row.copy()
    first_of_row[np.unique(best[:, 0], return_index=True)[1]] = True
    first_of_column[np.unique(best[:, 1], return_index=True)[1]] = True
    chosen: np.ndarray = best[first_of_row & first_of_column]
    return chosen


def near_projections(
    camera: Camera, T_world_camera: np.ndarray, points: np.ndarray, uv: np.ndarray, radius_px: float
) -> np.ndarray:
    """(C, 2) pairs of features at uv (N, 2) and points (P, 3) ahead of the camera whose projection is near."""
    local = transform(inverse(T_world_camera)[None], points)
    ahead = np.flatnonzero(local[:, 2] > 0.05)
    features, projected = cKDTree(uv), cKDTree(project(camera, local[ahead]))
    pairs = features.sparse_distance_matrix(projected, radius_px, output_type="coo_matrix")
    return np.column_stack([pairs.row, ahead[pairs.col]])


def project(camera: Camera, local: np.ndarray) -> np.ndarray:
    """(N, 3) points in camera axes -> (N, 2) pixels; meaningless behind the camera."""
    focal, centre = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    pixels: np.ndarray = focal * local[:, :2] / np.maximum(local[:, 2:], 1e-6) + centre
    return pixels


def back_projected(camera: Camera, uv: np.ndarray) -> np.ndarray:
    """(N, 2) pixels -> (N, 3) points in camera axes at a depth of 1."""
    x, y = (uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], -1)
