"""The graph of keyframes: frames between those that are adjusted together follow them."""

from __future__ import annotations

import numpy as np
from uncle.recon.core.se3 import apply_motion
from uncle.recon.tracking import keyframe_graph
from uncle.recon.tracking.keyframe_graph import KeyframeGraph

KEYFRAMES = (0, 4, 8)


def test_frames_between_keyframes_that_move_far_move_along_and_are_placed(make_scene, make_graph, monkeypatch):
    """30 and 60 cm of drift that a loop takes out of the keyframes: more than 20 pixels, which pass for outliers."""
    scene = make_scene(12)
    shift = np.repeat([0.0, 0.3, 0.6], 4) + np.where(np.isin(np.arange(12), KEYFRAMES), 0, 0.005)
    drift = shift[:, None] * np.array([1.0, 0, 0, 0, 0, 0])
    graph = make_graph(scene.camera, apply_motion(scene.poses, drift), scene.points, scene.observations, KEYFRAMES)
    adjust = KeyframeGraph._adjust

    def close(self, positions, free, iterations, free_points=True):
        if not free_points:
            return adjust(self, positions, free, iterations, free_points)
        for position in positions:
            self.frames[position].pose = scene.poses[position]

    monkeypatch.setattr(KeyframeGraph, "_adjust", close)
    monkeypatch.setattr(keyframe_graph, "_MAX_CAMERAS", 3)
    graph.adjust_globally()
    off = [np.linalg.norm(s.pose[:3, 3] - true[:3, 3]) for s, true in zip(graph.frames, scene.poses, strict=True)]
    assert max(off) < 1e-3
