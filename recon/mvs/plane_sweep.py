"""Plane-sweep stereo around the current surface: depth of one reference view from several source views.

Depth sensors can share an error in every frame (a stereo matcher smooths the same corner everywhere). The colours of
several views agree only where the surface really is. A narrow band of inverse depth around the surface of the map is
searched for the best agreement, and inputs for a noise model of the resulting depth are recorded.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from ..core.camera import Camera
from ..core.config.uncle import PhotometricConfig
from .cost_volume import CostVolumeParameters, GreyView, texture, zncc_volume

# Inputs of the noise model of photometric depth, in the order of `PlaneSweepView.inputs`.
PHOTOMETRIC_INPUTS = (
    "zncc", "peak_curvature", "peak_margin", "texture", "depth", "resolution", "offset", "gain", "offset_deviation",
)  # fmt: skip


@dataclass(frozen=True)
class PlaneSweepParameters:
    """Search band and acceptance of matches.

    search_px, step_px: half width and step of the search, in pixels of the source with the longest baseline;
    min_peak_distance: steps between the best and the second-best peak; min_inverse_depth: 1 / metres, farther points
    have too little parallax; min_zncc: lower scores are rounding noise of uniform images; cost: of the cost volume.
    """

    search_px: float = 4.0
    step_px: float = 0.5
    min_peak_distance: int = 2
    min_inverse_depth: float = 0.1
    min_zncc: float = 1e-3
    cost: CostVolumeParameters = field(default_factory=CostVolumeParameters)

    @staticmethod
    def from_config(config: PhotometricConfig) -> PlaneSweepParameters:
        """The parameters with those that are settings taken from `config`."""
        cost = replace(CostVolumeParameters(), window_px=config.window_px)
        return replace(PlaneSweepParameters(), search_px=config.search_px, step_px=config.step_px, cost=cost)


@dataclass(frozen=True)
class PlaneSweepView:
    """Depth of the reference view of frame `index`.

    depth (H, W) float32 metres, 0 = none; offset_from_prior (H, W): distance to the depth that the search was centred
    on, metres; inputs (H, W, F) float16 of its noise model; T_world_camera (4, 4); sources: indices of the frames that
    it was matched with.
    """

    index: int
    T_world_camera: np.ndarray
    depth: np.ndarray
    offset_from_prior: np.ndarray
    inputs: np.ndarray
    sources: tuple[int, ...]


def plane_sweep_depth(
    camera: Camera,
    reference: GreyView,
    sources: list[GreyView],
    prior: np.ndarray,
    parameters: PlaneSweepParameters = PlaneSweepParameters(),
) -> PlaneSweepView:
    """The depth of best agreement within `search_px` of `prior` (H, W) metres; none where the prior is 0 = unknown."""
    valid = prior > 0
    distance = float(np.median(prior[valid])) if valid.any() else 1.0
    baseline = max(float(np.linalg.norm(s.T_world_camera[:3, 3] - reference.T_world_camera[:3, 3])) for s in sources)
    step = parameters.step_px / (camera.fx * baseline)
    half = round(parameters.search_px / parameters.step_px)
    inverse = (1 / np.where(valid, prior, distance)).astype(np.float32)
    offsets = np.arange(-half, half + 1) * step
    volume = zncc_volume(camera, reference, sources, inverse, offsets, parameters.cost)
    peak = volume[1:-1].argmax(0) + 1
    before, best, after = (_layer(volume, peak + shift) for shift in (-1, 0, 1))
    curvature = np.maximum(2 * best - before - after, 1e-6)
    offset = peak - half + np.clip(0.5 * (after - before) / curvature, -0.5, 0.5)
    estimate = inverse + (offset * step).astype(np.float32)
    valid &= (best > parameters.min_zncc) & (estimate > parameters.min_inverse_depth)
    depth = np.where(valid, 1 / np.maximum(estimate, parameters.min_inverse_depth), 0).astype(np.float32)
    layers = np.arange(len(volume))[:, None, None]
    second = np.where(np.abs(layers - peak) > parameters.min_peak_distance, volume, -1).max(0)
    planes = [
        best, np.log10(curvature + 1e-3) + 2, best - second,
        np.log10(texture(reference.grey, parameters.cost.window_px) + 0.1) - 1, depth / 3,
        np.log10(depth**2 * step + 1e-4) + 1.5, np.abs(offset) / half, best - volume[half],
        _deviation_from_neighbours(offset) / half,
    ]  # fmt: skip
    inputs = np.stack(planes, -1).astype(np.float16)
    offset_from_prior = np.where(valid, np.abs(depth - prior), 0).astype(np.float32)
    frames = tuple(source.index for source in sources)
    return PlaneSweepView(reference.index, reference.T_world_camera, depth, offset_from_prior, inputs, frames)


def _layer(volume: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Values of the volume (n, H, W) at layer `index` (H, W)."""
    layer: np.ndarray = np.take_along_axis(volume, index[None], 0)[0]
    return layer


def _deviation_from_neighbours(offset: np.ndarray) -> np.ndarray:
    """(H, W) distance of the offset of a pixel from the median of those around it, steps."""
    deviation: np.ndarray = np.abs(offset - cv2.medianBlur(offset.astype(np.float32), 5))
    return deviation
