"""Keyframes, what they share, and keeping them consistent: local and global bundle adjustment."""

from __future__ import annotations

import numpy as np

from ..camera import Camera
from .bundle_adjustment import adjust, without_outliers
from .landmarks import NONE, Landmarks, Sighting, observations_of, seen_at_least
from .motion import inverse, transform

LOCAL_KEYFRAMES = 8
_LOCAL_ITERATIONS = 4
_OUTLIER = 5.0  # sigmas
_MAX_CAMERAS = 250  # adjusted together with all points; frames between them follow
_NEW_DEPTH_SIGMA = 0.15  # of the depth: a reading less certain makes no landmark


class KeyframeGraph:
    """All sightings in order, which of them are keyframes, and the landmarks they share."""

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        self.sightings: list[Sighting] = []
        self.keyframes: list[int] = []  # positions in `sightings`
        self.landmarks = Landmarks()

    def add(self, sighting: Sighting) -> int:
        """Remember a frame; returns its position."""
        self.sightings.append(sighting)
        return len(self.sightings) - 1

    def make_keyframe(self, position: int) -> None:
        """The frame lends its unmatched features, where they have depth, as new landmarks."""
        sighting = self.sightings[position]
        depth, sigma = sighting.mean_depth()
        new = np.flatnonzero((sighting.landmark == NONE) & (depth > 0) & (sigma < _NEW_DEPTH_SIGMA * depth))
        local = self._rays(sighting.features.uv[new]) * depth[new, None]
        points = transform(sighting.pose[None], local)
        sighting.landmark[new] = self.landmarks.add(points, sighting.features.descriptors[new])
        self.keyframes.append(position)

    def numbers(self, position: int) -> np.ndarray:
        """The landmarks (K,) that a frame sees, distinct."""
        current = self.landmarks.current(self.sightings[position].landmark)
        return np.unique(current[current >= 0])

    def covisible(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For each keyframe, how many of the landmarks `numbers` it sees; positions and counts, most first."""
        shared = np.array([np.isin(numbers, self.numbers(k), assume_unique=True).sum() for k in self.keyframes])
        order = np.argsort(-shared, kind="stable")
        return np.array(self.keyframes)[order], shared[order]

    def local_landmarks(self, pose: np.ndarray, numbers: np.ndarray, count: int = 6) -> np.ndarray:
        """Landmarks of the keyframes that share most with `numbers`, of the newest one, and of the nearest in view."""
        positions, shared = self.covisible(numbers)
        chosen = {*positions[:count][shared[:count] > 0].tolist(), self.keyframes[-1], *self._near(pose, 4)}
        return np.unique(np.concatenate([self.numbers(p) for p in sorted(chosen)]))

    def adjust_locally(self) -> None:
        """Bundle adjustment of the newest keyframes and those that share most with them; the others hold."""
        newest = self.keyframes[-1]
        positions, shared = self.covisible(self.numbers(newest))
        window = [p for p, s in zip(positions[:LOCAL_KEYFRAMES], shared, strict=False) if s > 0]
        inside = np.unique(np.concatenate([self.numbers(p) for p in window]))
        outside = [
            p for p in self.keyframes if p not in window and np.isin(self.numbers(p), inside).sum() >= 10
        ][-2 * LOCAL_KEYFRAMES :]  # fmt: skip
        cameras = [*window, *outside]
        free = np.array([p in window and p != self.keyframes[0] for p in cameras])
        if not outside and self.keyframes[0] not in window:
            free[-1] = False  # something must hold the rest
        self._adjust(cameras, free, _LOCAL_ITERATIONS)

    def adjust_globally(self, iterations: int = 30) -> None:
        """Bundle adjustment of the whole recording: some cameras with all points, then the frames between them."""
        with_pose = list(range(len(self.sightings)))
        stride = -(-len(with_pose) // _MAX_CAMERAS)
        cameras = sorted({*with_pose[::stride], *self.keyframes}) if stride > 1 else with_pose
        free = np.array([p != self.keyframes[0] for p in cameras])
        self._adjust(cameras, free, iterations)
        others = [p for p in with_pose if p not in set(cameras)]
        if others:
            self._adjust(others, np.ones(len(others), bool), 10, free_points=False)

    def _adjust(self, positions: list[int], free: np.ndarray, iterations: int, free_points: bool = True) -> None:
        sightings = [self.sightings[p] for p in positions]
        observations, numbers = observations_of(sightings, self.landmarks)
        poses, points = np.stack([s.pose for s in sightings]), self.landmarks.points[numbers]
        observations = without_outliers(self.camera, poses, points, observations, 3 * _OUTLIER)
        observations = observations[seen_at_least(observations, 2)] if free_points else observations
        first = max(2, iterations // 2)
        result = adjust(self.camera, poses, points, observations, free, free_points=free_points, iterations=first)
        kept = without_outliers(self.camera, result.poses, result.points, observations, _OUTLIER)
        result = adjust(
            self.camera, result.poses, result.points, kept, free, free_points=free_points, iterations=iterations - first
        )
        for sighting, pose, moves in zip(sightings, result.poses, free, strict=True):
            if moves:
                sighting.pose = pose
        if free_points:
            moved = np.unique(kept.point)
            self.landmarks.points[numbers[moved]] = result.points[moved]

    def _near(self, pose: np.ndarray, count: int) -> list[int]:
        """Keyframes that look from about the same place into about the same direction."""
        there = np.stack([self.sightings[k].pose for k in self.keyframes])
        between = inverse(pose) @ there
        angle = np.arccos(np.clip((np.trace(between[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))
        apart = np.linalg.norm(between[:, :3, 3], axis=1) + angle
        order = np.argsort(apart)[:count]
        return [self.keyframes[i] for i in order if apart[i] < 0.8]

    def _rays(self, uv: np.ndarray) -> np.ndarray:
        camera = self.camera
        x, y = (uv[:, 0] - camera.cx) / camera.fx, (uv[:, 1] - camera.cy) / camera.fy
        return np.stack([x, y, np.ones_like(x)], -1)
