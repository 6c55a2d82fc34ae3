"""Which frames become keyframes."""

from __future__ import annotations

import numpy as np

from ..core.config.uncle import TrackingConfig
from ..core.se3 import inverse, rotation_angle
from .frame_to_frame import SurfaceView
from .landmarks import FrameFeatures
from .pose_estimation import MIN_INLIERS


def becomes_keyframe(
    features: FrameFeatures, matches: int, view: SurfaceView | None, newest: FrameFeatures, config: TrackingConfig
) -> bool:
    """Whether a frame moved far from the `newest` keyframe, or matches few landmarks.

    It also needs features with depth, which become landmarks; without features, a `view` of the surface.
    """
    depth, _ = features.mean_depth()
    depth = depth[depth > 0]
    if len(depth) >= MIN_INLIERS:
        few_matches = matches < config.keyframe_matches
    elif view is None or not view.valid.any():
        return False
    else:
        depth, few_matches = view.points[view.valid][:, 2], False
    step = inverse(newest.pose) @ features.pose
    translation_ratio = np.linalg.norm(step[:3, 3]) / np.median(depth)
    return bool(
        few_matches
        or rotation_angle(step) > config.keyframe_rotation_rad
        or translation_ratio > config.keyframe_translation_ratio
    )
