"""Edges between poses: derivatives against differences, and graphs whose answer is known."""

from dataclasses import replace

import numpy as np
from uncle.recon.core.camera import Camera
from uncle.recon.core.se3 import apply_motion, inverse, motion_between
from uncle.recon.tracking.bundle_adjustment import adjust
from uncle.recon.tracking.observations import Observations
from uncle.recon.tracking.pose_graph_edges import PoseEdges, edges_among, linearise_edges

CAMERA = Camera(320, 240, 200.0, 200.0, 160.0, 120.0)
NOTHING = Observations(*(np.zeros(0, int),) * 2, np.zeros((0, 2)), np.zeros(0), *(np.zeros((0, 1)),) * 2, np.zeros(0))
STEP = 1e-6


def true_poses(count: int) -> np.ndarray:
    return apply_motion(np.eye(4), np.random.default_rng(1).uniform(-1, 1, (count, 6)))


def edges_of(poses: np.ndarray, pairs: list[tuple[int, int]], information: np.ndarray) -> PoseEdges:
    first, second = np.array(pairs).T
    return PoseEdges(first, second, inverse(poses[first]) @ poses[second], np.tile(information, (len(pairs), 1, 1)))


def solve(poses: np.ndarray, edges: PoseEdges) -> np.ndarray:
    free = np.arange(len(poses)) > 0
    return adjust(CAMERA, poses, np.zeros((0, 3)), NOTHING, free, iterations=50, edges=edges).poses


def test_gradient_is_that_of_the_cost():
    poses, rng = true_poses(4), np.random.default_rng(2)
    root = rng.normal(size=(6, 6))
    edges = edges_of(poses, [(0, 1), (1, 2), (2, 3), (0, 3)], 30 * (root @ root.T + np.eye(6)))
    poses = apply_motion(poses, rng.uniform(-1e-3, 1e-3, (4, 6)))  # small: `off` is taken as linear in the motions
    differences = np.zeros((4, 6))
    for place in np.ndindex(4, 6):
        step = np.zeros((4, 6))
        step[place] = STEP
        ahead, behind = (linearise_edges(apply_motion(poses, sign * step), edges).cost for sign in (1, -1))
        differences[place] = (ahead - behind) / (2 * STEP)
    gradient = 2 * linearise_edges(poses, edges).g
    assert np.abs(gradient).max() > 0.1
    np.testing.assert_allclose(gradient, differences, atol=5e-3 * np.abs(gradient).max())


def test_second_derivatives_are_those_of_the_gradient():
    poses = true_poses(3)
    edges = edges_of(poses, [(0, 1), (1, 2)], np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    found = linearise_edges(poses, edges)
    assert found.cost < 1e-20
    for place in np.ndindex(3, 6):
        step = np.zeros((3, 6))
        step[place] = 1e-5
        change = linearise_edges(apply_motion(poses, step), edges).g / 1e-5
        camera, axis = place
        np.testing.assert_allclose(change[camera], found.U[camera][:, axis], atol=1e-3)
        for edge, (first, second) in enumerate([(0, 1), (1, 2)]):
            if camera == second:
                np.testing.assert_allclose(change[first], found.across[edge][:, axis], atol=1e-3)


def test_a_graph_without_contradiction_comes_back():
    true = true_poses(5)
    edges = edges_of(true, [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4)], 100 * np.eye(6))
    start = apply_motion(true, np.random.default_rng(3).uniform(-0.1, 0.1, (5, 6)))
    start[0] = true[0]
    np.testing.assert_allclose(solve(start, edges), true, atol=1e-4)


def test_a_contradiction_is_shared_by_information():
    """Along a line: two steps say 1 m each, the whole says 2.3 m and is twice as sure: each step gets 1.12 m."""
    line = np.tile(np.eye(4), (3, 1, 1))
    line[:, 0, 3] = 0.0, 1.0, 2.0
    edges = edges_of(line, [(0, 1), (1, 2), (0, 2)], np.eye(6))
    edges.T_first_second[2, 0, 3] = 2.3
    edges.information[2] *= 2
    found = solve(line, edges)
    np.testing.assert_allclose(found[:, 0, 3], [0.0, 1.12, 2.24], atol=2e-3)
    np.testing.assert_allclose(found[:, :3, :3], line[:, :3, :3], atol=1e-6)


def test_an_edge_far_off_loses_its_influence():
    true = true_poses(4)
    pairs = [(0, 1), (1, 2), (2, 3), (0, 2), (1, 3)]
    edges = edges_of(true, [*pairs, (0, 3)], 1e6 * np.eye(6))
    wrong = edges.T_first_second.copy()
    wrong[-1] = apply_motion(wrong[-1], np.full(6, 0.3))
    found = solve(true, replace(edges, T_first_second=wrong))
    assert np.abs(motion_between(true, found)).max() < 0.003


def test_edges_among_some_frames_are_numbered_by_their_places():
    measured = [(a, b, np.eye(4) * a, np.eye(6) * b) for a, b in ((3, 9), (3, 4), (9, 20), (20, 21))]
    edges = edges_among(measured, [3, 9, 20])
    assert edges.first.tolist() == [0, 1]
    assert edges.second.tolist() == [1, 2]
    assert edges.T_first_second[1, 0, 0] == 9
    assert edges.information[1, 0, 0] == 20
    assert edges_among(measured, [4, 21]) is None
