"""Cameras that see known points, without noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from uncle.recon.core.camera import Camera
from uncle.recon.core.se3 import apply_motion, inverse, transform
from uncle.recon.tracking.keyframe_graph import KeyframeGraph
from uncle.recon.tracking.landmarks import FrameFeatures
from uncle.recon.tracking.observations import Observations

CAMERA = Camera(320, 240, 200.0, 210.0, 160.0, 118.0)


@dataclass(frozen=True)
class Scene:
    """`camera` at poses (C, 4, 4) sees all points (P, 3); two sensors, the first exact."""

    camera: Camera
    poses: np.ndarray
    points: np.ndarray
    observations: Observations

    def perturbed(self, shift_m: float, turn_rad: float, point_m: float) -> tuple[np.ndarray, np.ndarray]:
        """All poses but the first, and all points, moved at random."""
        rng = np.random.default_rng(7)
        motions = rng.uniform(-1, 1, (len(self.poses), 6)) * np.repeat([shift_m, turn_rad], 3)
        motions[0] = 0
        return apply_motion(self.poses, motions), self.points + rng.uniform(-point_m, point_m, self.points.shape)

    @property
    def free(self) -> np.ndarray:
        """All poses but the first."""
        return np.arange(len(self.poses)) > 0


@pytest.fixture
def make_scene():
    """Makes a scene; a share of the readings of the second sensor is wrong by `lie_m`."""

    def make(cameras: int = 4, points: int = 60, lying: float = 0.0, lie_m: float = 0.5) -> Scene:
        rng = np.random.default_rng(3)
        world = rng.uniform([-1.0, -0.8, 2.0], [1.0, 0.8, 3.5], (points, 3))
        poses = apply_motion(np.eye(4), rng.uniform(-1, 1, (cameras, 6)) * np.repeat([0.25, 0.08], 3))
        camera, point = (index.ravel() for index in np.indices((cameras, points)))
        local = transform(inverse(poses[camera]), world[point])
        uv = local[:, :2] / local[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
        depths = np.repeat(local[:, 2:], 2, 1)
        depths[rng.random(len(depths)) < 0.2, 0] = 0.0  # holes
        depths[rng.random(len(depths)) < lying, 1] += lie_m
        sigmas = 0.01 * np.maximum(depths, 1) ** 2
        ones = np.ones(len(uv))
        return Scene(CAMERA, poses, world, Observations(camera, point, uv, 0.7 * ones, depths, sigmas, ones))

    return make


@pytest.fixture
def make_graph():
    """Makes a graph of frames at `poses` with what they see; the landmarks are where the points are."""

    def make(camera, poses, points, observations: Observations, keyframes, common_px: float = 0.0) -> KeyframeGraph:
        graph = KeyframeGraph(camera, 0)
        graph.landmarks.add(points, np.zeros((len(points), 128), np.float32))
        for index, pose in enumerate(poses):
            own = observations[observations.camera == index]
            noise = np.zeros((*own.depths.shape, 0), np.float32)
            read = own.uv, own.sigma_px, own.depths, own.sigmas_m, np.zeros_like(own.depths), noise
            graph.frames.append(FrameFeatures(index, pose, *read, own.point.copy(), common_px))
        graph.keyframes = list(keyframes)
        return graph

    return make
