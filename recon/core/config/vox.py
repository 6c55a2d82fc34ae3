"""Settings of the method `vox-fusion`: the published values, except where a description says "ours"."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field


class VoxConfig(BaseModel):
    """The method `vox-fusion`: sparse voxels with embeddings at their corners, rendered as signed distances."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    voxel_size_m: float = Field(0.2, ge=0.02, le=2.0, description="Side of a voxel, metres.")
    channels: int = Field(16, ge=1, description="Length of the embedding at each corner.")
    hidden: int = Field(256, ge=4, description="Width of the two layers of the decoder, and of its colour head.")
    features: int = Field(128, ge=1, description="Features that the decoder passes to its colour head.")
    truncation_m: float = Field(
        0.05,
        gt=0,
        le=1.0,
        description="Distance from a measurement within which the signed distance is learned, metres.",
    )
    step_voxels: float = Field(0.05, gt=0, le=1.0, description="Distance between the samples on a ray, voxels.")
    max_voxels: int = Field(10, ge=1, le=64, description="Maximum number of voxels sampled on a ray, the first ones.")
    min_depth_m: float = Field(0.01, ge=0, description="Measurements nearer than this are ignored, metres.")
    max_depth_m: float = Field(
        10.0, gt=0.1, le=1000.0, description="Measurements beyond this depth are ignored, metres."
    )
    behind_m: float = Field(
        0.2, gt=0, description="No samples farther than this behind the largest depth on a ray, metres (ours; 100: no "
        "limit)."
    )  # fmt: skip
    color_weight: float = Field(0.5, ge=0, description="Weight of the colour error.")
    depth_weight: float = Field(1.0, ge=0, description="Weight of the depth error.")
    free_weight: float = Field(10.0, ge=0, description="Weight of the error in free space.")
    sdf_weight: float = Field(5000.0, ge=0, description="Weight of the squared error of the distance, 1/m^2.")
    rays: int = Field(2048, ge=16, description="Rays drawn from each frame of the window in each step of the mapping.")
    iterations: int = Field(20, ge=1, description="Steps of the mapping for each mapped frame.")
    first_iterations: int = Field(200, ge=1, description="Steps of the mapping for the first frame (ours).")
    learning_rate: float = Field(5e-3, gt=0, description="Step size of Adam for embeddings and decoder.")
    bfloat16: bool = Field(False, description="Compute the decoder's layers in bfloat16 while mapping and tracking.")
    window: int = Field(4, ge=0, description="Random keyframes that are mapped again with each frame.")
    keyframe_every: int = Field(50, ge=1, description="A frame more than this many after a keyframe becomes one.")
    map_every: int = Field(1, ge=1, description="Every n-th frame and the last one is mapped.")
    tracking_rays: int = Field(2048, ge=16, description="Rays drawn in each step of the tracking.")
    tracking_iterations: int = Field(50, ge=1, description="Steps of the tracking for each frame.")
    tracking_rate: float = Field(0.01, gt=0, description="Step size of Adam for the pose, metres and radians.")
    outlier_medians: float = Field(
        10.0,
        gt=1,
        description="Measurements with more than this many times the median depth error are not used in tracking.",
    )
    surface_readings: int = Field(
        1, ge=1, description="Number of the sampled images that must observe a place for it to be in the map (ours)."
    )


PRESET = {"uncertainty": {"enabled": False}, "photometric": {"enabled": False}}
