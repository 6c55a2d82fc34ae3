"""The default tracker."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..camera import Camera
from .bundle_adjustment import Observations
from .keyframe_graph import KeyframeGraph
from .landmarks import NONE, Sighting
from .local_features import match, match_near
from .motion import inverse, transform
from .pnp import agreeing, ransac_pose, refined_pose

_SEARCH_PX = 10.0
_SHARE = 0.65
_TURN_RAD, _SHIFT = 0.15, 0.08


class FeatureTracker:
    def __init__(self, camera: Camera, seed: int = 0) -> None:
        self.camera = camera
        self.graph = KeyframeGraph(camera)
        self.seed = seed
        self.velocity = np.eye(4)
        self.last: Sighting | None = None
        self.reference_matches = 0
        self.log = []

    def track(self, sighting: Sighting) -> Sighting | None:
        if self.last is None:
            self.graph.add(sighting)
            self.graph.make_keyframe(0)
            self.last = sighting
            self.reference_matches = int((sighting.landmark >= 0).sum())
            return sighting
        predicted = self.last.pose @ self.velocity
        current = self.graph.landmarks.current(self.last.landmark)
        numbers = self.graph.local_landmarks(predicted, np.unique(current[current >= 0]))
        points = self.graph.landmarks.points[numbers]
        similarity = sighting.features.descriptors @ self.graph.landmarks.descriptors[numbers].T
        pairs = match(similarity)
        found = ransac_pose(self.camera, points[pairs[:, 1]], sighting.features.uv[pairs[:, 0]], self.seed)
        if found is None:
            self.log.append((sighting.index, 'lost', len(pairs)))
            return None
        pose, kept = found
        pose, _ = refined_pose(self.camera, pose, points, _observations(sighting, pairs[kept]))
        pairs = match_near(similarity, self._near(pose, points, sighting.features.uv))
        observations = _observations(sighting, pairs)
        pose, _ = refined_pose(self.camera, pose, points, observations)
        observations = agreeing(self.camera, pose, points, observations)
        pose, information = refined_pose(self.camera, pose, points, observations)
        good = np.isin(pairs[:, 1], observations.point)
        sighting.landmark[pairs[good, 0]] = numbers[pairs[good, 1]]
        sighting.pose = pose
        self.velocity = inverse(self.last.pose) @ pose
        position = self.graph.add(sighting)
        self.last = sighting
        if self._is_keyframe(sighting, good.sum()):
            self.graph.make_keyframe(position)
            self.graph.adjust_locally()
            self.reference_matches = int((sighting.landmark >= 0).sum())
        return sighting

    def _is_keyframe(self, sighting: Sighting, matches: int) -> bool:
        newest = self.graph.sightings[self.graph.keyframes[-1]]
        step = inverse(newest.pose) @ sighting.pose
        turn = np.arccos(np.clip((np.trace(step[:3, :3]) - 1) / 2, -1, 1))
        depth, _ = sighting.mean_depth()
        typical = np.median(depth[depth > 0]) if (depth > 0).any() else 1.0
        return matches < 80 or turn > _TURN_RAD or np.linalg.norm(step[:3, 3]) > _SHIFT * typical

    def _near(self, pose, points, uv) -> np.ndarray:
        local = transform(inverse(pose)[None], points)
        z = np.maximum(local[:, 2], 1e-6)
        u = self.camera.fx * local[:, 0] / z + self.camera.cx
        v = self.camera.fy * local[:, 1] / z + self.camera.cy
        u[local[:, 2] < 0.05] = -1e6
        return (uv[:, :1] - u) ** 2 + (uv[:, 1:] - v) ** 2 < _SEARCH_PX**2


def _observations(sighting: Sighting, pairs: np.ndarray) -> Observations:
    rows = pairs[:, 0]
    return Observations(
        np.zeros(len(rows), np.int64), pairs[:, 1], sighting.features.uv[rows], sighting.features.sigma_px[rows],
        sighting.depths[rows], sighting.sigmas_m[rows],
    )  # fmt: skip
