"""Photometric depth: plane-sweep multi-view stereo as one more sensor of the map, with its own noise model.

In several passes: each searches around the surface of the map as it is then, and the map is integrated again with the
result. Its schedule ends when it is not validated, or when it no longer finds the surface away from the map.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import PhotometricConfig, UncertaintyConfig
from ..core.events import OnEvent, ignore
from ..core.frame import Frame
from ..sensors.noise_model import NoiseModel
from .bias_validation import Validation
from .photometric_noise import PhotometricNoiseParameters, fit_photometric_noise
from .photometric_samples import PhotometricDepthImage, PhotometricSamples, SurfaceRays, sample_view
from .plane_sweep import PlaneSweepView
from .stereo_views import ColorImages, StereoParameters, SurfaceDepth, compute_stereo_views, stereo_camera


@dataclass(frozen=True)
class PhotometricParameters:
    """Constants of photometric depth that are no settings.

    min_normalised_offset: median offset from the map, in units of beta, that calls for another pass; if the map is
    right, half of a Laplace distribution lies beyond ln 2, give or take.
    """

    min_normalised_offset: float = 1.1 * math.log(2)
    noise: PhotometricNoiseParameters = field(default_factory=PhotometricNoiseParameters)


@dataclass(frozen=True)
class PhotometricView:
    """A reference view: index of its frame, sources = indices of the frames it was matched with, T_world_camera (4, 4),
    depth (h, w) and beta (h, w, float16) in metres, 0 = none, at the size of the matched images."""

    index: int
    sources: tuple[int, ...]
    T_world_camera: Tensor
    depth: Tensor
    beta: Tensor


class PhotometricDepth:
    """Depth of reference views with the beta of each pixel, and samples of it for comparison with the sensors.

    views: of the latest pass that found any; samples: at their pixels, None before `collect_samples`;
    validated: an accepted bias correction has confirmed poses and colour calibration;
    passes: done so far; max_normalised_offset: largest median offset from the map in a pass, in units of beta.
    """

    def __init__(
        self,
        camera: Camera,
        config: PhotometricConfig,
        uncertainty: UncertaintyConfig,
        voxel_size_m: float,
        seed: int,
        parameters: PhotometricParameters = PhotometricParameters(),
    ) -> None:
        self.full_camera, self.config, self.uncertainty = camera, config, uncertainty
        self.voxel_size_m, self.seed, self.parameters = voxel_size_m, seed, parameters
        self.stereo = StereoParameters.from_config(config)
        self.camera = stereo_camera(camera, self.stereo)
        self.passes = 0
        self.max_normalised_offset = 0.0
        self.validated = False
        self.mapped_frames = 0
        self.views: list[PhotometricView] = []
        self.samples: PhotometricSamples | None = None

    # --- schedule ----------------------------------------------------------------------------------------------
    def update(
        self,
        frames: ColorImages,
        poses: Mapping[int, np.ndarray],
        surface: SurfaceDepth,
        on_event: OnEvent = ignore,
    ) -> float | None:
        """Run one pass: compute the depth of reference views along `poses` around `surface` and train its noise model.

        Returns the mean negative log-likelihood in nats. None if there were too few matches: the result of an earlier
        pass stays, and no more passes follow.
        """
        stereo_views = compute_stereo_views(frames, poses, surface, self.camera, self.config, self.stereo, on_event)
        fit = fit_photometric_noise(
            self.camera, stereo_views, self.uncertainty, self.seed, self.parameters.noise
        )  # fmt: skip
        self.passes = self.config.max_passes if fit is None else self.passes + 1
        if fit is None:
            return None
        noise, loss = fit
        self.clear()
        self.mapped_frames = len(poses)
        self.views = [_with_beta(view, noise) for view in stereo_views]
        offset = self._median_normalised_offset(stereo_views)
        self.max_normalised_offset = max(self.max_normalised_offset, offset)
        return loss

    def needs_another_pass(self) -> bool:
        """Whether photometric depth is validated and its median normalised offset exceeded the threshold in some pass.

        Such an offset moves the map and the sensor biases, and the next search starts from a better surface.
        """
        moved = self.max_normalised_offset > self.parameters.min_normalised_offset
        return self.validated and moved and self.passes < self.config.max_passes

    def set_validation(self, result: Validation) -> None:
        """Accept, reject (clear), or leave undecided."""
        if result is Validation.REJECTED:
            self.clear()
        self.validated = result is Validation.ACCEPTED

    def clear(self) -> None:
        """Drop views and samples."""
        self.views, self.samples = [], None

    # --- results -----------------------------------------------------------------------------------------------
    @property
    def indices(self) -> list[int]:
        """Frame indices of the reference views."""
        return [view.index for view in self.views]

    @property
    def frames_per_view(self) -> float:
        """Number of mapped frames that one reference view stands for."""
        return self.mapped_frames / max(len(self.views), 1)

    def depth_images(self) -> Iterator[PhotometricDepthImage]:
        """Depth and beta of each reference view at the size of the recording."""
        for view in self.views:
            yield self._at_full_size(view)

    def collect_samples(
        self, views: Iterable[tuple[Frame, Mapping[str, Tensor]]], surface: SurfaceRays
    ) -> PhotometricSamples:
        """Sample the reference views, given their frames with noise model inputs (H, W, F) by sensor, in order.

        The samples replace `samples`, and are returned.
        """
        parts = []
        for number, (frame, inputs) in enumerate(views):
            image, count = self._at_full_size(self.views[number]), self.config.samples_per_view
            sample = sample_view(number, image, frame.depths, inputs, self.full_camera, surface, count, self.seed)
            parts.append(sample)
        self.samples = PhotometricSamples.concatenate(parts)
        return self.samples

    def share_source_images(self) -> np.ndarray:
        """(V, V) bool: pairs of views with an image in common, whose errors are dependent; True on the diagonal."""
        images = [{view.index, *view.sources} for view in self.views]
        return np.array([[not one.isdisjoint(other) for other in images] for one in images])

    def _at_full_size(self, view: PhotometricView) -> PhotometricDepthImage:
        size = (self.full_camera.width, self.full_camera.height)
        depth, beta = (
            cv2.resize(image.float().numpy(), size, interpolation=cv2.INTER_NEAREST)
            for image in (view.depth, view.beta)
        )
        return PhotometricDepthImage(torch.from_numpy(depth), torch.from_numpy(beta), view.T_world_camera)

    def _median_normalised_offset(self, stereo_views: Sequence[PlaneSweepView]) -> float:
        """Median offset from the map in units of beta, over pixels whose beta is below the voxel size."""
        ratios = []
        for view, stereo_view in zip(self.views, stereo_views, strict=True):
            used = (view.depth > 0) & (view.beta < self.voxel_size_m)
            ratios.append(torch.from_numpy(stereo_view.offset_from_prior)[used] / view.beta[used].float())
        return float(torch.cat(ratios).median()) if any(map(len, ratios)) else 0.0

    # --- checkpoint --------------------------------------------------------------------------------------------
    def state_dict(self) -> dict[str, Any]:
        """Plain tensors and containers that `load_state_dict` continues from."""
        return {
            "passes": self.passes,
            "max_normalised_offset": self.max_normalised_offset,
            "validated": self.validated,
            "mapped_frames": self.mapped_frames,
            "views": [dict(vars(view)) for view in self.views],
            "samples": self.samples.state_dict() if self.samples is not None else None,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue from a state with the same settings."""
        self.passes, self.mapped_frames = state["passes"], state["mapped_frames"]
        self.max_normalised_offset, self.validated = state["max_normalised_offset"], state["validated"]
        self.views = [PhotometricView(**view) for view in state["views"]]
        self.samples = PhotometricSamples(**state["samples"]) if state["samples"] is not None else None


def _with_beta(view: PlaneSweepView, noise: NoiseModel) -> PhotometricView:
    depth = torch.from_numpy(view.depth)
    beta = noise.beta_image(depth, torch.from_numpy(view.inputs).float()).half()
    return PhotometricView(view.index, view.sources, torch.from_numpy(view.T_world_camera).float(), depth, beta)
