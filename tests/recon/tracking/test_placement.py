from dataclasses import replace

import numpy as np
import pytest
from uncle.recon.tracking.bundle_adjustment import (
    Observations,
    adjust,
    costs_by_camera,
    residuals,
    robust_weights,
)
from uncle.recon.tracking.motion import inverse, moved, transform
from uncle.recon.tracking.placement import distances, expectations, placed_again, surprise

SPEED = np.array([0.02, -0.01, 0.005, 0.01, 0.02, -0.005])  # of a hand, a frame
TIMES = np.array([0.0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12])


def walk(noise: float = 0.0) -> np.ndarray:
    poses = [np.eye(4)]
    for step in np.diff(TIMES):
        poses.append(moved(poses[-1], step * SPEED))
    return moved(np.stack(poses), np.random.default_rng(4).normal(0, noise or 1e-12, (len(TIMES), 6)))


@pytest.fixture
def seen(make_scene):
    """Camera, poses, points and what the poses see of them."""
    scene, poses = make_scene(), walk(1e-3)
    camera, point = (index.ravel() for index in np.indices((len(poses), len(scene.points))))
    local = transform(inverse(poses[camera]), scene.points[point])
    uv = local[:, :2] / local[:, 2:] * [scene.camera.fx, scene.camera.fy] + [scene.camera.cx, scene.camera.cy]
    ones = np.ones(len(uv))
    observations = Observations(camera, point, uv, 0.7 * ones, local[:, 2:], 0.01 * ones[:, None], ones)
    return scene.camera, poses, scene.points, observations


def test_a_camera_of_constant_speed_is_expected_where_it_is():
    poses = walk()
    expected = expectations(poses, TIMES)
    known = np.isfinite(expected[..., 0, 0])
    assert known.tolist() == [[0 < i < 11 for i in range(12)], [1 < i < 10 for i in range(12)],
                              [i > 1 for i in range(12)], [i < 10 for i in range(12)]]  # fmt: skip
    off = distances(poses, expected)
    assert np.isnan(off[~known]).all()
    assert off[known].max() < 3e-3, "a step of several frames turns a little on its way of some 10 cm"
    assert surprise(off, np.array([1.0, 1.0])).max() < 2e-3


def test_surprise_is_the_distance_from_the_nearest_expectation():
    poses = walk()
    poses[6] = moved(poses[6], np.array([0.0, 0.1, 0, 0, 0, 0]))
    found = surprise(distances(poses, expectations(poses, TIMES)), np.array([0.01, 0.01]))
    assert found[6] == pytest.approx(10, rel=0.02)
    assert np.delete(found, 6).max() < 0.2, "a wrong neighbour does not make the others surprising"


def test_costs_of_all_cameras_are_the_whole(seen):
    camera, poses, points, observations = seen
    off = moved(poses, np.tile([0.01, 0, 0, 0, 0, 0], (len(poses), 1)))
    r, _, _ = residuals(camera, off[observations.camera], points[observations.point], observations)
    costs = costs_by_camera(camera, off, points, observations)
    assert costs.shape == (len(poses),)
    assert costs.sum() == pytest.approx(robust_weights(r, observations.share_px)[1])


def test_a_frame_in_a_wrong_minimum_goes_back(seen):
    """Its own readings alone would leave it there: half of them were matched where it was thought to be."""
    camera, truth, points, observations = seen
    poses = truth.copy()
    poses[6] = moved(truth[6], np.array([0.12, 0.0, 0, 0, 0.03, 0]))
    wrong = (observations.camera == 6) & (observations.point % 2 == 0)
    local = transform(inverse(poses[6])[None], points[observations.point[wrong]])
    uv = observations.uv.copy()
    uv[wrong] = local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    depths = observations.depths.copy()
    depths[observations.camera == 6] = 0.0
    mixed = replace(observations, uv=uv, depths=depths)
    alone = adjust(camera, poses, points, mixed, np.arange(12) == 6, free_points=False).poses
    assert np.linalg.norm((inverse(truth[6]) @ alone[6])[:3, 3]) > 0.05
    found = placed_again(camera, poses, TIMES, points, mixed)
    assert np.linalg.norm((inverse(truth[6]) @ found[6])[:3, 3]) < 0.005
    others = np.arange(12) != 6
    assert (found[others] == poses[others]).all()


def test_a_real_jerk_stays(seen):
    camera, poses, points, observations = seen
    poses = poses.copy()
    poses[6] = moved(poses[6], np.array([0.06, 0.0, 0, 0, 0, 0]))
    local = transform(inverse(poses[observations.camera]), points[observations.point])
    uv = local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    found = placed_again(camera, poses, TIMES, points, replace(observations, uv=uv, depths=local[:, 2:]))
    np.testing.assert_allclose(found, poses, atol=1e-4)


def test_where_nothing_surprises_nothing_moves(seen):
    camera, poses, points, observations = seen
    assert placed_again(camera, poses, TIMES, points, observations) is poses


def test_a_surprising_frame_that_sees_nothing_goes_where_it_is_expected(seen):
    camera, truth, points, observations = seen
    poses = truth.copy()
    poses[6] = moved(truth[6], np.array([0.5, 0.0, 0, 0, 0, 0]))
    blind = observations[observations.camera != 6]
    found = placed_again(camera, poses, TIMES, points, blind)
    assert np.linalg.norm((inverse(truth[6]) @ found[6])[:3, 3]) < 0.01
