"""A keyframe graph: what keyframes share, which are near, and how frames follow them."""

import numpy as np
import pytest
from uncle.recon.core.se3 import apply_motion
from uncle.recon.tracking.keyframe_graph import KeyframeGraph


@pytest.fixture
def graph(make_scene, make_graph) -> KeyframeGraph:
    """Six frames of the same points, keyframes 0, 2 and 4, half a metre apart; 2 has lost most points."""
    scene = make_scene(6)
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 0, 3] = np.arange(6) * 0.25
    graph = make_graph(scene.camera, poses, scene.points, scene.observations, (0, 2, 4))
    graph.frames[2].landmark[5:] = -1
    return graph


def test_covisible_keyframes_come_in_the_order_of_what_they_share(graph):
    positions, shared = graph.covisible(np.arange(30))
    assert positions.tolist() == [0, 4, 2]
    assert shared.tolist() == [30, 30, 5]
    assert graph.well_constrained() == [0, 1, 3, 4, 5]


def test_near_keyframes_have_about_the_same_position_and_direction(graph):
    assert graph.near(graph.frames[3].pose, 2) == [2, 4]
    assert graph.near(apply_motion(graph.frames[3].pose, np.array([0, 0, 0, 0, 1.5, 0])), 2) == []
    assert graph.near(graph.frames[5].pose, 3) == [4, 2]


def test_local_landmarks_are_those_of_sharing_and_of_near_keyframes(graph):
    graph.frames[4].landmark[:] = -1
    graph.frames[4].landmark[0] = 59
    far = apply_motion(np.eye(4), np.array([50.0, 0, 0, 0, 0, 0]))
    assert graph.local_landmarks(far, np.array([0])).tolist() == list(range(60))
    graph.frames[0].landmark[:] = -1
    assert graph.local_landmarks(far, np.array([0])).tolist() == [0, 1, 2, 3, 4, 59]
    assert graph.local_landmarks(far, np.array([30])).tolist() == [59]


def test_frames_between_keyframes_follow_the_one_before(graph):
    before = graph.keyframe_poses()
    poses = [frame.pose.copy() for frame in graph.frames]
    shift = np.array([0.0, 0.1, 0, 0, 0, 0])
    graph.frames[2].pose = apply_motion(before[2], shift)
    graph.move_with_keyframes(before, {0, 2, 4})
    moved = [np.linalg.norm(f.pose[:3, 3] - p[:3, 3]) for f, p in zip(graph.frames, poses, strict=True)]
    np.testing.assert_allclose(moved, [0, 0, 0.1, 0.1, 0, 0], atol=1e-12)


@pytest.mark.parametrize(("count", "expected"), [(2, [9, 0]), (4, [9, 8, 0, 7]), (20, list(range(9, -1, -1)))])
def test_spread_keyframes_are_the_newest_and_some_before(graph, count, expected):
    graph.keyframes = list(range(10))
    assert graph.spread_keyframes(count) == expected
