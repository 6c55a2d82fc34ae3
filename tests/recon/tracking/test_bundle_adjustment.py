"""Bundle adjustment of scenes that are known, with SciPy as the oracle."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from uncle.recon.core.se3 import apply_motion, inverse, rotation_angle
from uncle.recon.tracking.bundle_adjustment import adjust, covariances
from uncle.recon.tracking.landmarks import pixel_information_factor
from uncle.recon.tracking.observations import (
    DEPTH_SCALE,
    PIXEL_SCALE,
    Observations,
    depth_information_factor,
    residuals,
    robust_weights,
)
from uncle.recon.tracking.pose_graph_edges import PoseEdges


def all_residuals(scene, poses, points):
    seen = scene.observations
    return residuals(scene.camera, poses[seen.camera], points[seen.point], seen)


def dense_jacobian(scene, poses, points) -> np.ndarray:
    """(M * (2 + S), 6 C + 3 P)."""
    _, d_motion, d_point = all_residuals(scene, poses, points)
    count, rows = len(d_motion), d_motion.shape[1]
    result = np.zeros((count, rows, 6 * len(poses) + 3 * len(points)))
    for i, (camera, point) in enumerate(zip(scene.observations.camera, scene.observations.point, strict=True)):
        result[i, :, 6 * camera : 6 * camera + 6] = d_motion[i]
        start = 6 * len(poses) + 3 * point
        result[i, :, start : start + 3] = d_point[i]
    return result.reshape(count * rows, -1)


def shrunk(r: np.ndarray, scale: float) -> np.ndarray:
    """Vectors (N, D), flat, made so short that their squared lengths are their Cauchy costs."""
    length = np.linalg.norm(r, axis=1, keepdims=True) + 1e-12
    return (r * scale * np.sqrt(np.log1p((length / scale) ** 2)) / length).ravel()


def shifts_and_turns(poses, true) -> tuple[float, float]:
    off = inverse(true) @ poses
    return float(np.abs(off[:, :3, 3]).max()), float(rotation_angle(off).max())


def test_an_error_that_is_read_again_says_no_more(make_scene):
    """All depth is 3 % too far. Frames that see nothing else, and repeat it, do not move points or cameras further."""
    scene = make_scene()
    seen = replace(scene.observations, depths=scene.observations.depths * 1.03)
    again = replace(seen, share_px=np.zeros(len(seen)))
    names = seen.__dataclass_fields__
    thrice = Observations(*(np.concatenate([getattr(o, name) for o in (seen, again, again)]) for name in names))
    once = adjust(scene.camera, scene.poses, scene.points, seen, scene.free, iterations=30)
    more = adjust(scene.camera, scene.poses, scene.points, thrice, scene.free, iterations=30)
    assert shifts_and_turns(once.poses, scene.poses)[0] > 0.001
    np.testing.assert_allclose(more.points, once.points, atol=1e-9)
    np.testing.assert_allclose(more.poses, once.poses, atol=1e-9)


def test_cameras_that_are_placed_on_held_points_do_not_share_their_readings(make_scene):
    """Each ends where it would without the others, also if all depth is too far and pixels count for little."""
    scene = make_scene()
    seen = replace(
        scene.observations, depths=scene.observations.depths * 1.03, share_px=np.full(len(scene.observations), 0.01)
    )
    held = {"free_points": False, "iterations": 30}
    together = adjust(scene.camera, scene.poses, scene.points, seen, scene.free, **held)
    for camera in np.flatnonzero(scene.free):
        own = seen[seen.camera == camera]
        alone = adjust(scene.camera, scene.poses, scene.points, own, np.arange(len(scene.poses)) == camera, **held)
        assert shifts_and_turns(alone.poses, scene.poses)[0] > 0.01
        np.testing.assert_allclose(together.poses[camera], alone.poses[camera], atol=2e-4)


def test_poses_and_points_come_back(make_scene):
    scene = make_scene()
    poses, points = scene.perturbed(0.05, 0.03, 0.1)
    found = adjust(scene.camera, poses, points, scene.observations, scene.free, iterations=30)
    shift, turn = shifts_and_turns(found.poses, scene.poses)
    assert shift < 1e-4
    assert turn < 1e-4
    np.testing.assert_allclose(found.points, scene.points, atol=5e-4)
    assert (found.poses[0] == poses[0]).all()


def test_a_sensor_that_lies_is_outvoted(make_scene):
    scene = make_scene(points=100, lying=0.4, lie_m=1.0)
    poses, points = scene.perturbed(0.03, 0.02, 0.05)
    found = adjust(scene.camera, poses, points, scene.observations, scene.free, iterations=50)
    shift, turn = shifts_and_turns(found.poses, scene.poses)
    assert shift < 0.005
    assert turn < 0.003
    assert np.median(np.linalg.norm(found.points - scene.points, axis=1)) < 0.01


def test_poses_come_back_with_points_held(make_scene):
    scene = make_scene()
    poses, _ = scene.perturbed(0.1, 0.05, 0.0)
    found = adjust(scene.camera, poses, scene.points, scene.observations, scene.free, free_points=False, iterations=30)
    shift, turn = shifts_and_turns(found.poses, scene.poses)
    assert shift < 1e-4
    assert turn < 1e-4
    assert (found.points == scene.points).all()


def test_agrees_with_dense_least_squares(make_scene):
    scene = make_scene(3, 8)
    rng = np.random.default_rng(5)
    noisy = replace(scene.observations, uv=scene.observations.uv + rng.normal(0, 0.7, scene.observations.uv.shape))
    scene = replace(scene, observations=noisy)
    poses, points = scene.perturbed(0.01, 0.01, 0.01)

    def at(x):
        steps = np.concatenate([np.zeros((1, 6)), x[:12].reshape(2, 6)])
        return apply_motion(poses, steps), points + x[12:].reshape(-1, 3)

    def robust(x):  # their squares are the robust cost; signed, so that derivatives are smooth
        r, _, _ = all_residuals(scene, *at(x))
        share = np.sqrt(depth_information_factor(scene.observations)).ravel()
        return np.concatenate([shrunk(r[:, :2], PIXEL_SCALE), shrunk(r[:, 2:].reshape(-1, 1), DEPTH_SCALE) * share])

    oracle = least_squares(robust, np.zeros(12 + points.size))
    found = adjust(scene.camera, poses, points, scene.observations, scene.free, iterations=100)
    assert found.cost == pytest.approx(2 * oracle.cost, rel=1e-3)
    shift, turn = shifts_and_turns(found.poses, at(oracle.x)[0])
    assert shift < 1e-3
    assert turn < 5e-4


def test_one_step_is_that_of_the_dense_normal_equations(make_scene):
    scene = make_scene(3, 12)
    start = scene.perturbed(1e-4, 1e-4, 1e-4)
    found = adjust(scene.camera, *start, scene.observations, scene.free, iterations=1)
    r, _, _ = all_residuals(scene, *start)
    weights, _ = robust_weights(r, np.ones(len(r)), depth_information_factor(scene.observations))
    J, root = dense_jacobian(scene, *start)[:, 6:], np.sqrt(weights).ravel()
    normal = J.T @ (J * root[:, None] ** 2)
    normal += np.diag(1e-4 * np.diag(normal) + 1e-9)  # the damping of a first step
    step = -np.linalg.solve(normal, J.T @ (root**2 * r.ravel()))
    poses = apply_motion(start[0][1:], step[:12].reshape(2, 6))
    np.testing.assert_allclose(found.poses[1:], poses, atol=1e-10)
    np.testing.assert_allclose(found.points, start[1] + step[12:].reshape(-1, 3), atol=1e-10)


@pytest.mark.parametrize("noise_px", [0.3, 0.7, 2.0])
def test_covariance_is_that_of_the_dense_inverse(make_scene, noise_px):
    scene = make_scene(3, 15)
    rng = np.random.default_rng(6)
    noisy = replace(scene.observations, uv=scene.observations.uv + rng.normal(0, noise_px, scene.observations.uv.shape))
    scene = replace(scene, observations=noisy)
    found = covariances(scene.camera, scene.poses, scene.points, scene.observations, scene.free)
    r, _, _ = all_residuals(scene, scene.poses, scene.points)
    weights, _ = robust_weights(r, np.ones(len(r)), depth_information_factor(scene.observations))
    J = dense_jacobian(scene, scene.poses, scene.points)[:, 6:]
    spread = 1.48 * np.median(np.abs(r[:, :2]))
    assert (spread > 1) == (noise_px > 1), "both sides of the sigma that pixels are said to have"
    dense = np.linalg.inv(J.T @ (J * weights.reshape(-1, 1))) * max(spread, 1) ** 2
    assert (found[0] == 0).all()
    for camera in (1, 2):
        block = slice(6 * camera - 6, 6 * camera)
        np.testing.assert_allclose(found[camera], dense[block, block], rtol=1e-4, atol=1e-4 * found[camera].max())


def test_a_sure_edge_makes_a_pose_surer(make_scene):
    scene = make_scene(3, 15)
    edges = PoseEdges(
        np.array([0]), np.array([2]), (inverse(scene.poses[0]) @ scene.poses[2])[None], 1e10 * np.eye(6)[None]
    )
    without = covariances(scene.camera, scene.poses, scene.points, scene.observations, scene.free)
    found = covariances(scene.camera, scene.poses, scene.points, scene.observations, scene.free, edges)
    assert (np.diagonal(found[2]) < 0.01 * np.diagonal(without[2])).all()


@pytest.mark.parametrize("error", [0.01, 0.1, 0.5, 3.0])
def test_cost_never_grows(make_scene, error):
    scene = make_scene(lying=0.3)
    poses, points = scene.perturbed(error, error, error)
    costs = [adjust(scene.camera, poses, points, scene.observations, scene.free, iterations=n).cost for n in range(8)]
    assert np.isfinite(costs).all()
    assert (np.diff(costs) <= 0).all()
    assert costs[-1] < costs[0]


def test_nothing_seen_moves_nothing(make_scene):
    scene = make_scene(3, 5)
    none = scene.observations[np.zeros(len(scene.observations), bool)]
    found = adjust(scene.camera, scene.poses, scene.points, none, scene.free)
    assert (found.poses == scene.poses).all()
    assert (found.points == scene.points).all()
    assert np.isfinite(covariances(scene.camera, scene.poses, scene.points, none, scene.free)).all()


def test_surfaces_outweigh_pixels_that_are_off_together(make_scene):
    """Colour of a camera whose focal length is 10 % larger than is believed, beside motions measured by depth."""
    scene = make_scene()
    centre = np.array([scene.camera.cx, scene.camera.cy])
    wrong = replace(scene.observations, uv=centre + 1.1 * (scene.observations.uv - centre))
    first, second = np.array([0, 1, 2]), np.array([1, 2, 3])
    motions = inverse(scene.poses[first]) @ scene.poses[second]
    edges = PoseEdges(first, second, motions, np.tile(np.diag([0.01**-2] * 3 + [0.01**-2] * 3), (3, 1, 1)))
    off = []
    for common in (0.0, 5.0):
        share = pixel_information_factor(wrong.sigma_px[: len(scene.points)], common)
        seen = replace(wrong, share_px=np.tile(share, len(scene.poses)))
        found = adjust(scene.camera, scene.poses, scene.points, seen, scene.free, edges=edges, iterations=30)
        off.append(shifts_and_turns(found.poses, scene.poses)[0])
    assert off[0] > 0.01
    assert off[1] < 0.25 * off[0]
