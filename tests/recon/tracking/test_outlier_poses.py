from dataclasses import replace

import numpy as np
import pytest
from uncle.recon.core.se3 import apply_motion, inverse, transform
from uncle.recon.tracking.bundle_adjustment import adjust
from uncle.recon.tracking.graph_adjustment import reoptimise_outlier_frames
from uncle.recon.tracking.observations import Observations, residuals, robust_weights
from uncle.recon.tracking.outlier_poses import expectations, nearest, pose_cost, reoptimise_outliers

SPEED = np.array([0.02, -0.01, 0.005, 0.01, 0.02, -0.005])  # of a hand, a frame
TIMES = np.array([0.0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11, 12])
FREE = np.ones(len(TIMES), bool)


def walk(noise: float = 0.0) -> np.ndarray:
    poses = [np.eye(4)]
    for step in np.diff(TIMES):
        poses.append(apply_motion(poses[-1], step * SPEED))
    return apply_motion(np.stack(poses), np.random.default_rng(4).normal(0, noise or 1e-12, (len(TIMES), 6)))


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
    assert nearest(poses, expected).max() < 1e-3, "a step of several frames turns a little on its way"


def test_frames_far_away_tell_nothing():
    times = np.where(np.arange(12) < 6, TIMES, TIMES + 40)
    known = np.isfinite(expectations(walk(), times)[..., 0, 0]).any(axis=0)
    assert known.all(), "each still has two on its own side"
    assert not np.isfinite(expectations(walk(), 10 * TIMES)).any()
    assert np.isinf(nearest(walk(), expectations(walk(), 10 * TIMES))).all()


def test_a_wrong_neighbour_does_not_make_others_surprising():
    poses = walk()
    poses[6] = apply_motion(poses[6], np.array([0.0, 0.1, 0, 0, 0, 0]))
    found = nearest(poses, expectations(poses, TIMES))[:, 0]
    assert found[6] == pytest.approx(0.1, rel=0.02)
    assert np.delete(found, 6).max() < 2e-3


def test_costs_of_all_frames_are_the_whole_where_they_are_expected(seen):
    camera, poses, points, observations = seen
    off = apply_motion(poses, np.tile([0.01, 0, 0, 0, 0, 0], (len(poses), 1)))
    r, _, _ = residuals(camera, off[observations.camera], points[observations.point], observations)
    costs = []
    for frame, pose in enumerate(off):
        own = observations[observations.camera == frame]
        own = replace(own, camera=np.zeros(len(own), np.int64))
        costs.append(pose_cost(camera, pose, pose[None], points, own, np.array([1e-3, 1e-3])))
    assert sum(costs) == pytest.approx(robust_weights(r, observations.share_px)[1])


@pytest.fixture
def confused(seen):
    """The same, where half of what frame 6 sees was matched where it was thought to be, and its depth is missing."""
    camera, truth, points, observations = seen
    poses = truth.copy()
    poses[6] = apply_motion(truth[6], np.array([0.12, 0.0, 0, 0, 0.03, 0]))
    wrong = (observations.camera == 6) & (observations.point % 2 == 0)
    local = transform(inverse(poses[6])[None], points[observations.point[wrong]])
    uv = observations.uv.copy()
    uv[wrong] = local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    depths = observations.depths.copy()
    depths[observations.camera == 6] = 0.0
    return camera, truth, poses, points, replace(observations, uv=uv, depths=depths)


def test_a_frame_in_a_wrong_minimum_goes_back(confused):
    """Its own readings alone would leave it there."""
    camera, truth, poses, points, mixed = confused
    alone = adjust(camera, poses, points, mixed, np.arange(12) == 6, free_points=False).poses
    assert np.linalg.norm((inverse(truth[6]) @ alone[6])[:3, 3]) > 0.05
    found = reoptimise_outliers(camera, poses, TIMES, points, mixed, FREE)
    assert np.linalg.norm((inverse(truth[6]) @ found[6])[:3, 3]) < 0.005
    others = np.arange(12) != 6
    assert (found[others] == poses[others]).all()

    held = reoptimise_outliers(camera, poses, TIMES, points, mixed, FREE & others)
    assert (held == poses).all(), "who is not free stays"


@pytest.mark.parametrize("common_px", [0.0, 3.0])
def test_the_graph_puts_back_frames_between_keyframes(confused, make_graph, common_px):
    camera, truth, poses, points, mixed = confused
    poses[4] = apply_motion(poses[4], np.array([0.0, 0.1, 0, 0, 0, 0]))
    graph = make_graph(camera, poses, points, mixed, (0, 4, 8), common_px)
    reoptimise_outlier_frames(graph)
    assert np.linalg.norm((inverse(truth[6]) @ graph.frames[6].pose)[:3, 3]) < 0.005
    assert all((graph.frames[n].pose == poses[n]).all() for n in range(12) if n != 6), "keyframes hold each other"


@pytest.mark.parametrize("jerk_m", [0.03, 0.06, 0.2, 0.6])
@pytest.mark.parametrize("count", [20, 60])
def test_a_real_jerk_stays(seen, jerk_m, count):
    camera, poses, points, observations = seen
    poses = poses.copy()
    poses[6] = apply_motion(poses[6], np.array([jerk_m, 0.0, 0, 0, 0, 0]))
    local = transform(inverse(poses[observations.camera]), points[observations.point])
    uv = local[:, :2] / local[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    jerked = replace(observations, uv=uv, depths=local[:, 2:])
    jerked = jerked[(jerked.camera != 6) | (jerked.point < count)]
    found = reoptimise_outliers(camera, poses, TIMES, points, jerked, FREE)
    np.testing.assert_allclose(found, poses, atol=1e-4)


def test_where_nothing_surprises_nothing_moves(seen):
    camera, poses, points, observations = seen
    assert (reoptimise_outliers(camera, poses, TIMES, points, observations, FREE) == poses).all()


@pytest.mark.parametrize("count", [0, 1, 2, 9, 12])
def test_few_frames_or_none_around_move_nothing(seen, count):
    camera, poses, points, observations = seen
    poses, kept = poses[:count].copy(), observations[observations.camera < count]
    poses[count // 2 : count // 2 + 1, 0, 3] += 1.0
    apart = 100.0 * np.arange(count)
    assert (reoptimise_outliers(camera, poses, apart, points, kept, FREE[:count]) == poses).all()


def test_a_frame_without_readings_stays(seen):
    camera, poses, points, observations = seen
    poses = poses.copy()
    poses[6] = apply_motion(poses[6], np.array([0.5, 0.0, 0, 0, 0, 0]))
    blind = observations[observations.camera != 6]
    assert (reoptimise_outliers(camera, poses, TIMES, points, blind, FREE) == poses).all()
