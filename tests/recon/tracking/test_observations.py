"""Residuals of what frames measured of landmarks, their derivatives and robust weights."""

from dataclasses import replace

import numpy as np
import pytest
from uncle.recon.core.se3 import apply_motion
from uncle.recon.tracking.observations import (
    DEPTH_SCALE,
    PIXEL_SCALE,
    depth_information_factor,
    residuals,
    robust_weights,
    without_outliers,
)

STEP = 1e-6


def all_residuals(scene, poses, points):
    seen = scene.observations
    return residuals(scene.camera, poses[seen.camera], points[seen.point], seen)


def test_residuals_vanish_at_the_truth_and_holes_have_none(make_scene):
    scene = make_scene()
    r, d_motion, d_point = all_residuals(scene, scene.poses, scene.points)
    np.testing.assert_allclose(r, 0, atol=1e-9)
    holes = scene.observations.depths == 0
    assert holes.any()
    assert (d_motion[:, 2:][holes] == 0).all()
    assert (d_point[:, 2:][holes] == 0).all()


def test_a_depth_residual_is_in_sigmas_of_inverse_depth(make_scene):
    scene = make_scene(1, 10)
    off = replace(scene.observations, depths=scene.observations.depths * 1.01)
    r, _, _ = residuals(scene.camera, scene.poses[off.camera], scene.points[off.point], off)
    true, sigma = scene.observations.depths[:, 1], off.sigmas_m[:, 1]
    expected = (1 / true - 1 / (1.01 * true)) / (sigma / (1.01 * true) ** 2)
    np.testing.assert_allclose(r[:, 3], expected)


@pytest.mark.parametrize("of", ["motion", "point"])
def test_jacobians_against_differences(make_scene, of):
    scene = make_scene()
    poses, points = scene.perturbed(0.05, 0.03, 0.05)
    seen = scene.observations
    T, X = poses[seen.camera], points[seen.point]
    analytic = residuals(scene.camera, T, X, seen)[1 if of == "motion" else 2]
    for axis in range(analytic.shape[-1]):
        step = np.zeros(analytic.shape[-1])
        step[axis] = STEP
        ends = [
            (apply_motion(T, np.tile(s * step, (len(T), 1))), X) if of == "motion" else (T, X + s * step)
            for s in (1, -1)
        ]
        ahead, behind = (residuals(scene.camera, *end, seen)[0] for end in ends)
        np.testing.assert_allclose(analytic[..., axis], (ahead - behind) / (2 * STEP), rtol=1e-5, atol=1e-4)


def test_robust_cost_of_known_residuals():
    r = np.array([[PIXEL_SCALE, 0.0, 0.0], [0.0, 0.0, DEPTH_SCALE]])
    weights, cost = robust_weights(r, np.ones(len(r)))
    np.testing.assert_allclose(weights, [[0.5, 0.5, 1.0], [1.0, 1.0, 0.5]])
    assert cost == pytest.approx((PIXEL_SCALE**2 + DEPTH_SCALE**2) * np.log(2))


def test_pixels_count_the_share_that_is_theirs():
    r = np.array([[PIXEL_SCALE, 0.0, 0.0], [0.0, PIXEL_SCALE, DEPTH_SCALE]])
    weights, cost = robust_weights(r, np.array([1.0, 0.1]))
    np.testing.assert_allclose(weights, [[0.5, 0.5, 1.0], [0.05, 0.05, 0.5]])
    assert cost == pytest.approx((1.1 * PIXEL_SCALE**2 + DEPTH_SCALE**2) * np.log(2))


def test_the_readings_of_a_sensor_of_one_point_share_its_information(make_scene):
    scene = make_scene()
    seen = scene.observations
    share = depth_information_factor(seen)
    for sensor in range(seen.depths.shape[1]):
        read = seen.depths[:, sensor] > 0
        total = np.bincount(seen.point[read], share[read, sensor], minlength=len(scene.points))
        np.testing.assert_allclose(total, np.bincount(seen.point[read], minlength=len(total)) > 0)


def test_outliers_are_left_out(make_scene):
    scene = make_scene(2, 20)
    uv, depths = scene.observations.uv.copy(), scene.observations.depths.copy()
    uv[3] += [0.7 * 6, 0.0]
    uv[4] += [0.7 * 4, 0.0]
    depths[5, 1] *= 2
    spoilt = replace(scene.observations, uv=uv, depths=depths)
    points = scene.points.copy()
    points[7] = scene.poses[1][:3, 3] - 2 * scene.poses[1][:3, 2]  # behind both cameras
    kept = without_outliers(scene.camera, scene.poses, points, spoilt, 5.0)
    expected = np.ones(40, bool)
    expected[[3, 7, 27]] = False
    assert kept.uv.tolist() == uv[expected].tolist()
    depths[5, 1] = 0.0
    assert kept.depths.tolist() == depths[expected].tolist()
