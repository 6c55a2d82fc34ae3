"""Plane-sweep depth of all chosen reference views, computed in parallel."""

from __future__ import annotations

import os
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Protocol

import cv2
import numpy as np
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import PhotometricConfig
from ..core.events import OnEvent, ignore, track_progress
from .cost_volume import GreyView
from .plane_sweep import PlaneSweepParameters, PlaneSweepView, plane_sweep_depth
from .view_selection import SurfaceDistance, ViewSelectionParameters, choose_reference_frames, choose_sources


class ColorImages(Protocol):
    """The part of `RunFrames` that stereo needs."""

    def color(self, index: int) -> Tensor:
        """(H, W, 3) uint8 RGB of a frame."""
        ...


class SurfaceDepth(SurfaceDistance, Protocol):
    """The part of `TsdfSurface` that stereo needs."""

    def depth_from(self, camera: Camera, T_world_camera: np.ndarray) -> np.ndarray:
        """(h, w) z-depth of the surface, metres, 0 = none."""
        ...


@dataclass(frozen=True)
class StereoParameters:
    """Images of more than `max_pixels` are halved: a finer resolution than that of the map costs time only."""

    max_pixels: int = 200_000
    selection: ViewSelectionParameters = field(default_factory=ViewSelectionParameters)
    sweep: PlaneSweepParameters = field(default_factory=PlaneSweepParameters)

    @staticmethod
    def from_config(config: PhotometricConfig) -> StereoParameters:
        """The parameters with those that are settings taken from `config`."""
        selection = ViewSelectionParameters(max_sources=config.max_sources)
        return StereoParameters(selection=selection, sweep=PlaneSweepParameters.from_config(config))


def stereo_camera(camera: Camera, parameters: StereoParameters = StereoParameters()) -> Camera:
    """The camera of the images that are matched: `camera`, or of half its size if its images are large."""
    large = camera.width * camera.height > parameters.max_pixels
    return camera.resized(camera.width // 2, camera.height // 2) if large else camera


def compute_stereo_views(
    frames: ColorImages,
    poses: Mapping[int, np.ndarray],
    surface: SurfaceDepth,
    camera: Camera,
    config: PhotometricConfig,
    parameters: StereoParameters,
    on_event: OnEvent = ignore,
) -> list[PlaneSweepView]:
    """Plane-sweep depth of reference views along the trajectory `poses` (T_world_camera by frame index).

    `camera` is that of `stereo_camera`. Views without enough sources or without a surface in sight are left out.
    """
    chosen = choose_reference_frames(camera, poses, surface, config)
    min_sources = parameters.selection.min_sources
    if len(chosen) <= min_sources:
        return []
    views = [GreyView(index, _grey(frames.color(index), camera), poses[index]) for index in chosen]
    matrices = np.stack([view.T_world_camera for view in views])

    def compute(row: int) -> PlaneSweepView | None:
        prior = surface.depth_from(camera, matrices[row])
        if not (prior > 0).any():
            return None
        distance_m = float(np.median(prior[prior > 0]))
        sources = choose_sources(camera, matrices, row, distance_m, parameters.selection)
        if len(sources) < min_sources:
            return None
        return plane_sweep_depth(camera, views[row], [views[s] for s in sources], prior, parameters.sweep)

    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        results = pool.map(compute, range(len(views)))
        results = track_progress(results, len(views), "matching views", on_event, "views")
        return [view for view in results if view is not None]


def _grey(color: Tensor, camera: Camera) -> np.ndarray:
    """(H, W, 3) uint8 RGB -> (h, w) float32 grey levels at the size of `camera`."""
    grey = cv2.cvtColor(color.numpy(), cv2.COLOR_RGB2GRAY)
    if grey.shape != (camera.height, camera.width):
        grey = cv2.resize(grey, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return grey.astype(np.float32)
