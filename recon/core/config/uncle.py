"""Settings of the default method, `uncle`."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator

from .base import Strict


class FusionConfig(Strict):
    """Closed-form fusion of depth images."""

    voxel_size_m: float = Field(
        0.0,
        ge=0.0,
        le=0.5,
        description="Distance between the samples of the map, metres, at least 0.001; 0: chosen from the recording.",
    )
    truncation_voxels: float = Field(
        4.0,
        ge=2.0,
        le=16.0,
        description="Distances are truncated at this many voxels in front of and behind a measurement.",
    )
    max_depth_m: float = Field(
        6.0, gt=0.1, le=1000.0, description="Measurements beyond this depth are ignored, metres."
    )
    discretisation_voxels: float = Field(
        0.5, ge=0, description="Discretisation error of the grid, added to beta in the fusion weights, voxels."
    )
    min_observations: float = Field(
        3.0, ge=1.0, description="A sample with fewer observations is not part of the surface."
    )
    passes: int = Field(
        1,
        ge=0,
        description="Integration passes over all frames after the online pass, each with the latest noise models.",
    )

    @field_validator("voxel_size_m")
    @classmethod
    def _voxel_is_not_tiny(cls, size_m: float) -> float:
        if 0.0 < size_m < 0.001:
            raise ValueError("should be at least 0.001, or 0 for a size that is chosen from the recording")
        return size_m


class UncertaintyConfig(Strict):
    """The noise model h_w of each sensor: a network from its image to the error scale beta of each pixel."""

    enabled: bool = Field(
        True, description="Learn the noise of each sensor; false: all measurements have the same weight."
    )
    hidden: int = Field(16, ge=4, description="Width of the two hidden layers.")
    inputs: tuple[str, ...] = Field(
        (), description='Inputs of the network, for ablations, such as ["depth", "incidence"]; empty: all.'
    )
    beta_min_m: float = Field(1e-3, gt=0, description="Smallest beta, metres (1e-3 in UncLe-SLAM).")
    learning_rate: float = Field(
        3e-3, gt=0, description="Step size of Adam at the start of each training; it falls linearly to a tenth."
    )
    steps_per_keyframe: int = Field(
        10, ge=0, description="Training steps on the pixels of each new keyframe before it is integrated."
    )
    steps_per_pass: int = Field(
        400, ge=0, description="Training steps on the pixels of all keyframes after each integration pass."
    )
    batch: int = Field(4096, ge=16, description="Pixels of a training step.")


class KeyframeConfig(Strict):
    """Frames whose pixels are kept for learning."""

    max_overlap: float = Field(
        0.9, gt=0, le=1.0, description="A frame is a keyframe if no earlier one sees more than this fraction of it."
    )
    rays: int = Field(3000, ge=100, description="Random pixels kept of a keyframe.")
    max_rays: int = Field(400_000, ge=1000, description="Pixels kept in all; beyond it random ones are dropped.")


class FieldConfig(Strict):
    """The neural field and its refinement by rendering."""

    iterations: int = Field(
        200, ge=0, description="Steps of the refinement by rendering; 0: the field is the fused map."
    )
    rays: int = Field(
        2048, ge=64, description="Rays rendered in each step, half of them of photometric depth where there is any."
    )
    samples: int = Field(8, ge=4, description="Samples on each ray, around the current surface.")
    span_voxels: float = Field(
        2.5, gt=0, description="Distance from the surface up to which a ray is sampled on either side, voxels."
    )
    sharpness_voxels: float = Field(
        0.4, gt=0, description="Width of the rendering weights around the surface, voxels; well below the span."
    )
    levels: tuple[Annotated[int, Field(ge=1, le=64)], ...] = Field(
        (4, 12), description="Cell sizes of the coarser feature grids, 1 to 64 voxels each."
    )
    channels: int = Field(4, ge=1, description="Number of features at each sample of the coarser grids.")
    hidden: int = Field(24, ge=4, description="Width of the decoder's hidden layer.")
    learning_rate_sdf_m: float = Field(
        1e-4, gt=0, description="Step size of Adam for the offsets at the samples near the surface, metres."
    )
    learning_rate: float = Field(2.5e-3, gt=0, description="Step size of Adam for the feature grids and the decoder.")
    sensor_only_rate_ratio: float = Field(
        0.1, gt=0, le=1, description="Factor on `learning_rate` where there is no photometric depth."
    )
    final_rate_ratio: float = Field(
        0.05, gt=0, le=1, description="Factor on both step sizes at the last step; they fall to it gradually."
    )
    color_weight: float = Field(0.1, ge=0, description="Weight of the colour error beside the likelihood of depth.")
    prior_weight: float = Field(1.0, ge=0, description="Weight of the penalty on offsets from the fused distances.")


class PhotometricConfig(Strict):
    """Photometric depth: plane-sweep multi-view stereo around the surface of the map."""

    enabled: bool = Field(
        True, description="Correct the map by multi-view stereo of the colour images; needs the uncertainty."
    )
    max_passes: int = Field(
        3,
        ge=1,
        description="Maximum number of photometric passes; stops early when the median offset from the map is within "
        "its own error.",
    )
    estimate_reliability: bool = Field(
        True,
        description="Estimate the reliability of each sensor by cross-view prediction; false: one third for all.",
    )
    max_views: int = Field(150, ge=3, description="Maximum number of reference views.")
    min_baseline_ratio: float = Field(
        0.03, gt=0, description="A frame becomes a reference view when the camera moved by this fraction of the depth."
    )
    min_rotation_rad: float = Field(
        0.07, gt=0, description="A frame becomes a reference view when the camera rotated by this angle, radians."
    )
    max_sources: int = Field(6, ge=2, le=32, description="Maximum number of source views of a reference view.")
    window_px: int = Field(9, ge=3, le=31, description="Side of the matching window, pixels.")
    search_px: float = Field(
        4.0, gt=0, le=64, description="Half width of the search around the map, pixels of the most distant source."
    )
    step_px: float = Field(0.5, gt=0, le=4, description="Step of the search, pixels of the most distant source.")
    max_registration_px: float = Field(
        1.0, ge=0, description="Photometric depth is skipped if the colour-depth registration error is larger, pixels."
    )
    samples_per_view: int = Field(
        3000, ge=100, description="Pixels of a reference view at which it is compared with the sensors."
    )


class TrackingConfig(Strict):
    """Estimation of the pose of every frame."""

    enabled: bool = Field(False, description="Estimate the poses; false: use those of the recording; set by `--track`.")
    color: bool = Field(
        True, description="Use colour: features and photometric residuals; set by `--color` and `--no-color`."
    )
    features: int = Field(1000, ge=50, description="Maximum number of features of an image, the strongest first.")
    depth_samples: int = Field(1000, ge=0, description="Depth samples of each sensor that are aligned with the map.")
    integrate_every: int = Field(
        3, ge=1, description="Every n-th frame and every keyframe is integrated while tracking; the others afterwards."
    )
    keyframe_matches: int = Field(80, ge=12, description="A frame with fewer matches becomes a keyframe.")
    keyframe_rotation_rad: float = Field(
        0.1, gt=0, description="A frame that rotated by more than this since the last keyframe becomes one, radians."
    )
    keyframe_translation_ratio: float = Field(
        0.05, gt=0, description="A frame that moved by more than this fraction of its depth becomes a keyframe."
    )


class FaultDetectionConfig(Strict):
    """Detection of sensors that drop out, freeze or disagree with the map in the middle of a recording."""

    enabled: bool = Field(
        True, description="Leave out a sensor in the frames in which it is faulty; false: use all measurements."
    )
    min_valid_ratio: float = Field(
        0.05,
        ge=0,
        lt=1,
        description="A sensor is missing in a frame with at most this fraction of its usual valid pixels.",
    )
    max_median_shift: float = Field(
        0.03,
        gt=0,
        description="Allowed shift of a sensor's median relative depth error beyond the range of its earlier frames.",
    )
    max_mad: float = Field(0.05, gt=0, description="Allowed median absolute deviation of the relative depth error.")
