"""Settings of `uncle-paper` and `nice-slam` (docs/uncle-paper.md); the defaults are the papers' numbers for Replica."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field

from .base import Strict


class NiceConfig(Strict):
    """Feature grids, rendering and uncertainty of `uncle-paper` and `nice-slam`."""

    reproduce_released_code: bool = Field(
        False,
        description="Follow the released code where it differs from the text of the paper (docs/uncle-paper.md).",
    )
    weighting: Literal["laplace", "uniform", "confidence"] = Field(
        "laplace",
        description="Weights of measurements: learned beta, all alike, or a confidence network; set by the preset.",
    )
    decoders: str = Field(
        "", description="File of the occupancy decoders; empty: those of the package; random: untrained."
    )
    bound: tuple[float, ...] = Field(
        (), description="Box of the scene x0, x1, y0, y1, z0, z1, metres; empty: from depth and poses."
    )
    middle_voxel_m: float = Field(0.32, gt=0.01, le=2.0, description="Cell of the middle grid, metres (TUM: 0.16).")
    fine_voxel_m: float = Field(0.16, gt=0.01, le=2.0, description="Cell of the fine grid, metres (TUM: 0.08).")
    color_voxel_m: float = Field(0.16, gt=0.01, le=2.0, description="Cell of the colour grid, metres (TUM: 0.08).")
    uniform_samples: int = Field(32, ge=2, description="Samples on a ray from the camera to the largest depth.")
    surface_samples: int = Field(16, ge=2, description="Samples around the depth of each sensor, within 5 percent.")
    noise_features: Literal[2, 7] = Field(
        2, description="Inputs of h_w at a pixel; 2: depth and incidence; 7: with normal and gradients."
    )
    noise_patch: Literal[1, 5] = Field(
        5, description="Side of the patch of these inputs around a pixel; 1: the pixel alone."
    )
    beta_min_m: float = Field(
        1e-3, gt=0, description="Smallest beta, metres; and the smallest scale of colour errors, 0 to 1."
    )
    color: bool = Field(True, description="Map colour, too.")
    color_weight: float = Field(
        0.2, ge=0, description="Weight of the colour error in mapping where its scale is not learned."
    )


class NiceMappingConfig(Strict):
    """The mapper of `uncle-paper` and `nice-slam`."""

    every: int = Field(5, ge=1, description="Every n-th frame is mapped (TUM: 2).")
    first_iterations: int = Field(1500, ge=1, description="Steps on the first frame.")
    iterations: int = Field(60, ge=1, description="Steps on each later frame.")
    pixels: int = Field(5000, ge=16, description="Rays in each step, spread evenly over the frames of the window.")
    window: int = Field(5, ge=2, description="Frames in a step, the current one included (7-Scenes, TUM: 10).")
    keyframe_every: int = Field(50, ge=1, description="Frames from one keyframe to the next.")
    fine_stage_start: float = Field(
        0.6,
        ge=0,
        le=1,
        description="Fraction of the steps on the middle grid alone; 0.4 in the released code, with colour from 0.6.",
    )
    learning_rate_middle: float = Field(0.1, gt=0, description="Step size of Adam for the middle grid, alone.")
    learning_rate: float = Field(
        0.005, gt=0, description="Step size of Adam for all grids and the colour decoder afterwards."
    )
    learning_rate_noise: float = Field(3e-4, gt=0, description="Step size of Adam for the networks h_w.")
    learning_rate_pose: float = Field(
        1e-3, gt=0, description="Step size of Adam for the poses of the bundle adjustment."
    )
    first_factor: float = Field(5.0, gt=0, description="Factor on the step sizes on the first frame.")
    bundle_adjustment: bool = Field(
        True, description="Optimise the poses of the window while mapping, where they were estimated."
    )
    refine: bool = Field(True, description="Repeat the mapping five times on twice the window after the last frame.")


class NiceTrackingConfig(Strict):
    """The tracker of `uncle-paper` and `nice-slam`: Adam on the rendering loss."""

    iterations: int = Field(10, ge=1, description="Steps on a frame (TUM: 30).")
    pixels: int = Field(5000, ge=16, description="Rays in each step.")
    learning_rate: float = Field(1e-3, gt=0, description="Step size of Adam for the translation (TUM: 0.003).")
    rotation_factor: float = Field(
        1.0, gt=0, description="Factor on `learning_rate` for the rotation (7-Scenes, TUM: 0.2)."
    )
    edge: int = Field(20, ge=0, description="Width of the image border that is not used, pixels.")
    color_weight: float = Field(0.5, ge=0, description="Weight of the colour error where no uncertainty is learned.")


# the parts of `uncle` that these methods do not use; their field is sampled at the voxel size
OPTIMISED: dict[str, Any] = {
    "fusion": {"voxel_size_m": 0.04, "max_depth_m": 10.0, "min_observations": 1.0},
    "uncertainty": {"enabled": False},
    "fault_detection": {"enabled": False},
    "photometric": {"enabled": False},
    "field": {"iterations": 0, "levels": []},
}
PRESETS: dict[str, dict[str, Any]] = {
    "uncle-paper": {**OPTIMISED, "nice": {"weighting": "laplace"}},
    "nice-slam": {**OPTIMISED, "nice": {"weighting": "uniform"}},
    "nice-slam-pre": {**OPTIMISED, "nice": {"weighting": "confidence"}},
}
