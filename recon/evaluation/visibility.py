"""What the cameras of a run saw, for scoring only that."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..core.camera import project_into
from ..core.errors import DataError, RunError
from ..core.frame import GROUND_TRUTH_SENSOR
from ..core.mesh import Mesh
from ..core.mesh_raycaster import Surface
from ..run.directory import RunDirectory
from ..run.frames import RunFrames

BEHIND_M = 0.2  # how far behind a reading a point still counts as visible
FEW_FRAMES = 60  # fewer are all asked; of more, every second at most: neighbours see the same
MAX_STRIDE = 4  # pixels between the readings that stand for the seen reference; fewer where there are few
REFERENCE_READINGS = 1_000_000
REFERENCE_VOXEL_M = 0.015
MAX_FRAMES = 250  # evenly spread; more change the outcome by less than the sampling does


@dataclass(frozen=True)
class Visibility:
    """Which points the frames of a run saw.

    `sensors` is the ground-truth sensor alone where the run has it, otherwise all: a point counts if one sees it.
    `indices` are the frames that are asked.
    """

    frames: RunFrames
    sensors: tuple[str, ...]
    indices: tuple[int, ...]

    @property
    def has_true_depth(self) -> bool:
        return self.sensors == (GROUND_TRUTH_SENSOR,)

    @staticmethod
    def of_run(run: RunDirectory, max_frames: int = MAX_FRAMES) -> Visibility:
        """Raises RunError if the run has no frames, DataError if none has a pose."""
        available = run.manifest.sensors
        sensors = (GROUND_TRUTH_SENSOR,) if GROUND_TRUTH_SENSOR in available else available
        frames = RunFrames(run, sensors)
        posed = [index for index in range(len(frames)) if frames.pose(index) is not None]
        if not posed:
            raise DataError(f"{run.root} has no camera poses from its data set, so what the cameras saw is unknown")
        if not sensors:
            raise RunError(f"{run.root} has no depth sensor; redo it with `uncle preprocess`")
        step = 1 if len(posed) < FEW_FRAMES else max(2, -(-len(posed) // max_frames))
        return Visibility(frames, sensors, tuple(posed[::step]))

    def seen(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points, metres -> (N,) bool: in some image and not more than `BEHIND_M` behind its reading."""
        found = np.zeros(len(points), dtype=bool)
        pending = np.arange(len(points))  # points that no frame has accepted yet
        for T_world_camera, depths in self._views():
            inside, pixels, z = project_into(points[pending], self.frames.camera, T_world_camera)
            reading = np.max(depths, axis=0)[pixels[:, 1], pixels[:, 0]]
            found[pending[inside[(reading > 0) & (z < reading + BEHIND_M)]]] = True
            pending = pending[~found[pending]]
            if len(pending) == 0:
                break
        return found

    def reference_points(self, reference: Mesh) -> np.ndarray:
        """(M, 3) points of the reference surface that the frames saw, one in each voxel of `REFERENCE_VOXEL_M`.

        They come from the ground-truth depth where the run has it. Elsewhere the reference is rendered at the poses
        of the run and kept in the pixels where a sensor has a reading.
        """
        surface = None if self.has_true_depth else Surface(reference)
        camera = self.frames.camera
        readings = len(self.indices) * camera.width * camera.height
        stride = min(MAX_STRIDE, math.ceil(math.sqrt(readings / REFERENCE_READINGS)))
        rays = camera.rays().numpy()[::stride, ::stride]
        points = [np.zeros((0, 3))]
        for T_world_camera, depths in self._views():
            depth = np.max(depths, axis=0)[::stride, ::stride]
            if surface is not None:
                rendered = surface.cast(T_world_camera[:3, 3], rays @ T_world_camera[:3, :3].T)
                depth = np.where(depth > 0, rendered, 0.0)
            valid = depth > 0
            local = rays[valid] * depth[valid][:, None]
            points.append(local @ T_world_camera[:3, :3].T + T_world_camera[:3, 3])
        return voxel_means(np.concatenate(points), REFERENCE_VOXEL_M)

    def _views(self) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
        for index in self.indices:
            depths = [self.frames.depth(index, sensor).numpy() for sensor in self.sensors]
            yield self.frames.pose(index), depths


def voxel_means(points: np.ndarray, voxel_m: float) -> np.ndarray:
    """(N, 3) points -> (M, 3): the mean of the points in each occupied cube of `voxel_m`, in order of the cubes."""
    if len(points) == 0:
        return points
    keys = np.floor((points - points.min(axis=0)) / voxel_m + 0.5).astype(np.int64)  # outer walls lie mid-cube
    cubes = np.ravel_multi_index(keys.T, keys.max(axis=0) + 1)
    _, owner, counts = np.unique(cubes, return_inverse=True, return_counts=True)
    return np.column_stack([np.bincount(owner, points[:, axis]) for axis in range(3)]) / counts[:, None]
