"""Depth from colour: what several views of the same place say about where its surface is.

Depth sensors can agree and be wrong together: a stereo matcher smooths the same corner in every frame. Colours of a
place as seen from several sides only agree where the surface really is. Around the surface that the map has so far,
the depth of best agreement is found, and h_w of one more sensor, colour, learns how far to believe it: not from the
map, which this witness is to correct, but from what its own views say about each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..core.camera import Camera
from .cost_volume import GreyView, texture, zncc_volume
from .multi_view_consistency import view_overlap

SOURCES = 6
MIN_SOURCES = 2
ANGLES = (0.06, 0.45)  # radians between the rays to a point: less measures nothing, more sees it too differently
MIN_OVERLAP = 0.5  # share of the reference that a source sees
SEARCH_PX = 4.0  # on either side, in the source that moved most
STEP_PX = 0.5
FEATURES = (
    "agreement", "sharpness", "margin", "texture", "depth", "resolution", "offset", "gain", "surprise",
)  # fmt: skip
_SAME_ANGLE = 0.02  # radians: a source nearer to another than this adds nothing
_ALIKE = 2  # steps: a second-best depth nearer than this is the same peak
_MIN_INVERSE = 0.1  # 1 / metres: what is farther moves too little
_MIN_AGREEMENT = 1e-3  # less is rounding: flat images agree on nothing


@dataclass(frozen=True)
class PlaneSweepView:
    """depth (H, W) float32 metres, 0 = none, and how far that `moved` from where it was looked for; features (H, W, F)
    float16 for its noise model; where it was taken."""

    index: int
    T_world_camera: np.ndarray
    depth: np.ndarray
    moved: np.ndarray
    features: np.ndarray
    sources: tuple[int, ...]


def choose_sources(camera: Camera, T_world_camera: np.ndarray, reference: int, distance_m: float) -> list[int]:
    """Rows of T_world_camera (N, 4, 4) that see what `reference` sees, from other places, the best ones first."""
    poses, here = T_world_camera, T_world_camera[reference]
    shift = np.linalg.norm(poses[:, :3, 3] - here[:3, 3], axis=1)
    angle = np.arctan2(shift, distance_m)
    overlap = view_overlap(camera, poses, here, distance_m)
    able = (angle > ANGLES[0]) & (angle < ANGLES[1]) & (overlap > MIN_OVERLAP)
    chosen: list[int] = []
    for row in np.argsort(-(overlap + np.minimum(angle, 0.3)), kind="stable"):
        apart = [np.linalg.norm(poses[row, :3, 3] - poses[other, :3, 3]) > _SAME_ANGLE * distance_m for other in chosen]
        if able[row] and all(apart):
            chosen.append(int(row))
        if len(chosen) == SOURCES:
            break
    return chosen


def plane_sweep_depth(
    camera: Camera, reference: GreyView, sources: list[GreyView], prior: np.ndarray
) -> PlaneSweepView:
    """The depth of best agreement within `SEARCH_PX` of `prior` (H, W) metres, 0 = unknown: nothing is looked for."""
    valid = prior > 0
    distance = float(np.median(prior[valid])) if valid.any() else 1.0
    baseline = max(float(np.linalg.norm(s.T_world_camera[:3, 3] - reference.T_world_camera[:3, 3])) for s in sources)
    step = STEP_PX / (camera.fx * baseline)
    half = round(SEARCH_PX / STEP_PX)
    inverse = (1 / np.where(valid, prior, distance)).astype(np.float32)
    volume = zncc_volume(camera, reference, sources, inverse, np.arange(-half, half + 1) * step)
    peak = volume[1:-1].argmax(0) + 1
    before, best, after = (_layer(volume, peak + shift) for shift in (-1, 0, 1))
    sharpness = np.maximum(2 * best - before - after, 1e-6)
    offset = peak - half + np.clip(0.5 * (after - before) / sharpness, -0.5, 0.5)
    found = inverse + (offset * step).astype(np.float32)
    valid &= (best > _MIN_AGREEMENT) & (found > _MIN_INVERSE)
    depth = np.where(valid, 1 / np.maximum(found, _MIN_INVERSE), 0).astype(np.float32)
    layers = np.arange(len(volume))[:, None, None]
    second = np.where(np.abs(layers - peak) > _ALIKE, volume, -1).max(0)
    planes = [
        best, np.log10(sharpness + 1e-3) + 2, best - second, np.log10(texture(reference.grey) + 0.1) - 1, depth / 3,
        np.log10(depth**2 * step + 1e-4) + 1.5, np.abs(offset) / half, best - volume[half], _surprise(offset) / half,
    ]  # fmt: skip
    features = np.stack(planes, -1).astype(np.float16)
    moved = np.where(valid, np.abs(depth - prior), 0).astype(np.float32)
    return PlaneSweepView(
        reference.index, reference.T_world_camera, depth, moved, features, tuple(s.index for s in sources)
    )


def _layer(volume: np.ndarray, index: np.ndarray) -> np.ndarray:
    """(n, H, W) at layer `index` (H, W)."""
    return np.take_along_axis(volume, index[None], 0)[0]


def _surprise(offset: np.ndarray) -> np.ndarray:
    """How far the found offset lies from the median of those around it, steps."""
    return np.abs(offset - cv2.medianBlur(offset.astype(np.float32), 5))
