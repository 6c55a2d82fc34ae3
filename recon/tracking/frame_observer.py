"""All that the tracker takes from a frame, for the settings and sensors of one recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from torch import Tensor

from ..core.camera import Camera
from ..core.config.uncle import TrackingConfig
from ..core.frame import Frame
from ..sensors.noise_model import NoiseModel
from .frame_observations import Prepared, observe_features, prepare, sample_depth_points, surface_view, weigh
from .frame_to_frame import SurfaceView
from .frame_to_model import Readings
from .landmarks import FrameFeatures

MIN_SAMPLES = 300  # of depth: fewer are not aligned with the surface


@dataclass(frozen=True)
class FrameObserver:
    """noise: models of the sensors in their order; registration_sigma_px: error that all pixels of a frame share.

    The methods take noise inputs (H, W, F) by sensor, none where the uncertainty is not learned.
    """

    camera: Camera
    config: TrackingConfig
    noise: Sequence[NoiseModel | None]
    registration_sigma_px: float
    max_depth_m: float

    def prepare(self, frame: Frame, normals: dict[str, Tensor]) -> Prepared:
        """What needs nothing but the frame and its normals (H, W, 3) by sensor."""
        return prepare(frame, normals, self.camera, self.config)

    def features(self, frame: Frame, prepared: Prepared, inputs: dict[str, Tensor]) -> FrameFeatures:
        """The features with the depth of all sensors; the pose is not known yet."""
        common_px = self.registration_sigma_px
        return observe_features(frame, prepared.features, inputs, self.noise, self.camera, common_px)

    def depth_samples(self, frame: Frame, inputs: dict[str, Tensor]) -> Readings | None:
        """Samples to align with the surface of the map; None where there are too few."""
        if self.config.depth_samples == 0:
            return None
        samples = sample_depth_points(frame, inputs, self.noise, self.camera, self.config, self.max_depth_m)
        return samples if len(samples) >= MIN_SAMPLES else None

    def view(self, frame: Frame, prepared: Prepared, inputs: dict[str, Tensor]) -> SurfaceView:
        """The surface as the frame sees it."""
        return surface_view(frame, prepared, inputs, self.noise, self.camera, self.max_depth_m)

    def update_sigmas(self, features: FrameFeatures) -> None:
        """Set the sigmas of the depths by what the noise models know now."""
        weigh(features, self.noise)
