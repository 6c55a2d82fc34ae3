"""Adjusting parts of a keyframe graph: frames between those that are adjusted together follow them."""

from __future__ import annotations

import numpy as np
from uncle.recon.core.se3 import apply_motion
from uncle.recon.tracking import graph_adjustment
from uncle.recon.tracking.graph_adjustment import (
    adjust_frames,
    adjust_globally,
    place_on_landmarks,
    pose_covariances,
    reoptimise_outlier_frames,
)

KEYFRAMES = (0, 4, 8)


def test_frames_between_keyframes_that_move_far_move_along_and_are_placed(make_scene, make_graph, monkeypatch):
    """30 and 60 cm of drift that a loop takes out of the keyframes: more than 20 pixels, which pass for outliers."""
    scene = make_scene(12)
    shift = np.repeat([0.0, 0.3, 0.6], 4) + np.where(np.isin(np.arange(12), KEYFRAMES), 0, 0.005)
    drift = shift[:, None] * np.array([1.0, 0, 0, 0, 0, 0])
    graph = make_graph(scene.camera, apply_motion(scene.poses, drift), scene.points, scene.observations, KEYFRAMES)

    def close(graph, positions, free, iterations, free_points=True):
        if not free_points:
            return adjust_frames(graph, positions, free, iterations, free_points)
        for position in positions:
            graph.frames[position].pose = scene.poses[position]

    monkeypatch.setattr(graph_adjustment, "adjust_frames", close)
    monkeypatch.setattr(graph_adjustment, "MAX_CAMERAS", 3)
    adjust_globally(graph)
    off = [np.linalg.norm(s.pose[:3, 3] - true[:3, 3]) for s, true in zip(graph.frames, scene.poses, strict=True)]
    assert max(off) < 1e-3


def test_adjusting_nothing_changes_nothing(make_scene, make_graph):
    """No frame has enough features: the poses stay exactly where they are."""
    scene = make_scene(4, points=5)
    graph = make_graph(scene.camera, scene.perturbed(0.01, 0.01, 0.0)[0], scene.points, scene.observations, (0, 2), 3.0)
    before = [s.pose.copy() for s in graph.frames]
    adjust_frames(graph, [], np.zeros(0, bool), 10)
    place_on_landmarks(graph)
    reoptimise_outlier_frames(graph)
    assert pose_covariances(graph) == {}
    np.testing.assert_array_equal([s.pose for s in graph.frames], before)


def test_frames_are_placed_on_landmarks_that_hold_still(make_scene, make_graph):
    scene = make_scene(6)
    drifted, _ = scene.perturbed(0.01, 0.01, 0.0)
    graph = make_graph(scene.camera, drifted, scene.points, scene.observations, (0, 3))
    place_on_landmarks(graph)
    np.testing.assert_allclose([s.pose for s in graph.frames], scene.poses, atol=1e-4)
    np.testing.assert_array_equal(graph.landmarks.points, scene.points)


def test_the_first_keyframe_has_no_covariance_and_the_others_have_one(make_scene, make_graph):
    scene = make_scene(6)
    found = pose_covariances(make_graph(scene.camera, scene.poses, scene.points, scene.observations, (0, 3)))
    assert not found[0].any()
    assert sorted(found) == list(range(6))
    assert min(np.linalg.eigvalsh(found[p])[0] for p in range(1, 6)) > 0
