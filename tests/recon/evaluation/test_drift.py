"""Drift of constructed trajectories."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.recon.core.se3 import rotation_angle
from uncle.recon.evaluation.drift import measure_drift


def straight(count: int = 101, step_m: float = 0.05) -> np.ndarray:
    """(N, 4, 4) poses along x."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = step_m * np.arange(count)
    return poses


TIMES = 0.1 * np.arange(101)  # 5 m in 10 s


def test_a_constant_offset_is_no_drift():
    found = straight()
    found[:, :3, 3] += [0.3, 0.0, 0.4]
    drift = measure_drift(found, straight(), TIMES)
    assert drift.path_m == pytest.approx(5.0)
    assert (drift.growth_ratio, drift.growth_m_per_s) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert (drift.segment_translation_ratio, drift.segment_rotation_rad_per_m) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert drift.segments == 81  # the last 20 starts have less than a metre before them


def test_drift_linear_in_time():
    """2 cm in every second sideways, that is in every half metre of way."""
    found = straight()
    found[:, 1, 3] = 0.02 * TIMES
    drift = measure_drift(found, straight(), TIMES)
    assert drift.growth_m_per_s == pytest.approx(0.02)
    assert drift.growth_ratio == pytest.approx(0.04)
    assert drift.segment_translation_ratio == pytest.approx(0.04)
    assert drift.segment_rotation_rad_per_m == pytest.approx(0.0, abs=1e-9)


def test_drift_of_the_rotation():
    found = straight()
    found[:, :3, :3] = Rotation.from_rotvec([[0, 0, 0.01 * x] for x in found[:, 0, 3]]).as_matrix()
    assert measure_drift(found, straight(), TIMES).segment_rotation_rad_per_m == pytest.approx(0.01)


def test_errors_of_a_loop_that_closes_have_segments_but_no_growth():
    found = straight()
    found[:, 1, 3] = 0.1 * np.sin(np.linspace(0, np.pi, 101))
    drift = measure_drift(found, straight(), TIMES)
    assert drift.growth_ratio == pytest.approx(0.0, abs=1e-9)
    assert drift.segment_translation_ratio > 0.02


def test_short_still_and_single_poses():
    short = measure_drift(straight(5), straight(5), None)
    assert (short.segments, short.segment_translation_ratio, short.growth_m_per_s) == (0, None, None)
    still = np.tile(np.eye(4), (5, 1, 1))
    assert measure_drift(still, still, TIMES[:5]) is None
    assert measure_drift(straight(1), straight(1), TIMES[:1]) is None


def test_angles_near_zero_and_near_half_a_turn():
    angles = np.array([0.0, 1e-9, 1.0, np.pi - 1e-7, np.pi])
    axis = np.array([0.6, 0.0, 0.8])
    rotations = Rotation.from_rotvec(angles[:, None] * axis).as_matrix()
    np.testing.assert_allclose(rotation_angle(rotations), angles, atol=1e-12)
