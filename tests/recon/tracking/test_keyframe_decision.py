"""Which frames become keyframes: those that moved or match little, and that show enough depth."""

import numpy as np
import pytest
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.uncle import TrackingConfig
from uncle.recon.core.se3 import apply_motion
from uncle.recon.tracking.frame_to_frame import SurfaceView
from uncle.recon.tracking.keyframe_decision import becomes_keyframe
from uncle.recon.tracking.landmarks import NONE, FrameFeatures

CONFIG = TrackingConfig()
MANY = CONFIG.keyframe_matches


def frame(motion=(0, 0, 0, 0, 0, 0), features: int = 50, depth_m: float = 2.0) -> FrameFeatures:
    """A frame that moved from the origin by `motion`, with features at one depth."""
    column = np.ones((features, 1))
    return FrameFeatures(
        0, apply_motion(np.eye(4), np.array(motion, float)), np.zeros((features, 2)), np.ones(features),
        depth_m * column, 0.01 * column, 0 * column, np.zeros((features, 1, 0), np.float32), np.full(features, NONE),
    )  # fmt: skip


def surface(depth_m: float, sigma: float = 0.01) -> SurfaceView:
    points = np.zeros((4, 4, 3))
    points[..., 2] = depth_m
    return SurfaceView(Camera(4, 4, 4.0, 4.0, 2.0, 2.0), points, np.zeros((4, 4, 3)), np.full((4, 4), sigma))


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        ((0.0, 0, 0, 0, 0, 0), False),
        ((0, 0, 0, 0, 0.9 * CONFIG.keyframe_rotation_rad, 0), False),
        ((0, 0, 0, 0, 1.1 * CONFIG.keyframe_rotation_rad, 0), True),
        ((1.8 * CONFIG.keyframe_translation_ratio, 0, 0, 0, 0, 0), False),
        ((2.2 * CONFIG.keyframe_translation_ratio, 0, 0, 0, 0, 0), True),
    ],
)
def test_a_frame_that_rotated_or_moved_by_a_share_of_its_depth(motion, expected):
    assert becomes_keyframe(frame(motion), MANY, None, frame(), CONFIG) is expected


def test_few_matches_make_a_keyframe():
    assert becomes_keyframe(frame(), MANY - 1, None, frame(), CONFIG)
    assert not becomes_keyframe(frame(), MANY, None, frame(), CONFIG)


def test_without_features_a_surface_is_needed():
    moved = (0.3, 0, 0, 0, 0, 0)
    assert not becomes_keyframe(frame(moved, features=3), 0, None, frame(), CONFIG)
    assert not becomes_keyframe(frame(moved, features=3), 0, surface(2.0, np.inf), frame(), CONFIG)
    assert becomes_keyframe(frame(moved, features=3), 0, surface(2.0), frame(), CONFIG)
    assert not becomes_keyframe(frame(moved, features=3), 0, surface(20.0), frame(), CONFIG), "small for its depth"
    assert not becomes_keyframe(frame(features=3), 0, surface(2.0), frame(), CONFIG), "matches do not count"
