"""Which parts of a scene the cameras of a run saw, so that only those are scored."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..core.camera import project_into
from ..core.errors import DataError, RunError
from ..core.frame import GROUND_TRUTH_SENSOR
from ..core.mesh import Mesh, PointCloud
from ..core.mesh_raycaster import Surface
from ..core.row_keys import row_keys
from ..run.directory import RunDirectory
from ..run.frames import RunFrames


@dataclass(frozen=True)
class VisibilityParameters:
    """What counts as seen by a camera, and how many frames and pixels are used.

    max_behind_m        a point counts as visible up to this far behind the depth measurement of its pixel
    all_frames_below    runs with fewer posed frames use all of them; longer ones every second frame at most, because
                        neighbours see the same
    max_frames          frames that are used, evenly spread; more change the scores by less than the sampling does
    max_stride          pixels between the samples of the seen reference, at most
    max_reference_samples   the stride is the smallest with which no more samples are made, up to `max_stride`
    reference_voxel_m   one point of the seen reference is kept in each voxel
    """

    max_behind_m: float = 0.2
    all_frames_below: int = 60
    max_frames: int = 250
    max_stride: int = 4
    max_reference_samples: int = 1_000_000
    reference_voxel_m: float = 0.015


DEFAULT_PARAMETERS = VisibilityParameters()


@dataclass(frozen=True)
class Visibility:
    """Which points the frames of a run saw.

    sensors   the ground-truth sensor alone where the run has it, else all: a point counts if one of them sees it
    indices   frames that are used
    """

    frames: RunFrames
    sensors: tuple[str, ...]
    indices: tuple[int, ...]
    parameters: VisibilityParameters = DEFAULT_PARAMETERS

    @property
    def has_true_depth(self) -> bool:
        """Whether visibility is decided by ground-truth depth."""
        return self.sensors == (GROUND_TRUTH_SENSOR,)

    @staticmethod
    def of_run(run: RunDirectory, parameters: VisibilityParameters = DEFAULT_PARAMETERS) -> Visibility:
        """Raises RunError if the run has no frames, DataError if none has a pose."""
        available = run.load_manifest().sensors
        sensors = (GROUND_TRUTH_SENSOR,) if GROUND_TRUTH_SENSOR in available else available
        frames = RunFrames(run, sensors)
        posed = [index for index in range(len(frames)) if frames.pose(index) is not None]
        if not posed:
            raise DataError(f"{run.root} has no camera poses from its data set, so what the cameras saw is unknown")
        if not sensors:
            raise RunError(f"{run.root} has no depth sensor; redo it with `uncle preprocess`")
        step = 1 if len(posed) < parameters.all_frames_below else max(2, -(-len(posed) // parameters.max_frames))
        return Visibility(frames, sensors, tuple(posed[::step]), parameters)

    def is_visible(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) world points, metres -> (N,) bool: inside some image and at most `max_behind_m` behind its depth."""
        visible = np.zeros(len(points), dtype=bool)
        pending = np.arange(len(points))  # points that no frame has seen yet
        for T_world_camera, depths in self._views():
            inside, pixels, z = project_into(points[pending], self.frames.camera, T_world_camera)
            depth = np.max(depths, axis=0)[pixels[:, 1], pixels[:, 0]]
            visible[pending[inside[(depth > 0) & (z < depth + self.parameters.max_behind_m)]]] = True
            pending = pending[~visible[pending]]
            if len(pending) == 0:
                break
        return visible

    def reference_points(self, reference: Mesh | PointCloud) -> np.ndarray:
        """(M, 3) points of the reference surface that the frames saw, one in each voxel.

        They are back-projected from the ground-truth depth where the run has it. Elsewhere the reference is rendered
        at the poses of the run and kept in the pixels where a sensor has a measurement; of a point cloud the visible
        points are taken.
        """
        if isinstance(reference, PointCloud) and not self.has_true_depth:
            points = reference.points.astype(np.float64)
            return voxel_means(points[self.is_visible(points)], self.parameters.reference_voxel_m)
        surface = Surface(reference) if isinstance(reference, Mesh) and not self.has_true_depth else None
        stride = self._stride()
        rays = self.frames.camera.rays().numpy()[::stride, ::stride]
        seen = [np.zeros((0, 3))]
        for T_world_camera, depths in self._views():
            depth = np.max(depths, axis=0)[::stride, ::stride]
            if surface is not None:
                rendered = surface.cast(T_world_camera[:3, 3], rays @ T_world_camera[:3, :3].T)
                depth = np.where(depth > 0, rendered, 0.0)
            valid = depth > 0
            local = rays[valid] * depth[valid][:, None]
            seen.append(local @ T_world_camera[:3, :3].T + T_world_camera[:3, 3])
        return voxel_means(np.concatenate(seen), self.parameters.reference_voxel_m)

    def _stride(self) -> int:
        """Pixels between the samples of the seen reference."""
        camera = self.frames.camera
        pixels = len(self.indices) * camera.width * camera.height
        return min(self.parameters.max_stride, math.ceil(math.sqrt(pixels / self.parameters.max_reference_samples)))

    def _views(self) -> Iterator[tuple[np.ndarray, list[np.ndarray]]]:
        for index in self.indices:
            depths = [self.frames.depth(index, sensor).numpy() for sensor in self.sensors]
            yield self.frames.known_pose(index), depths


def voxel_means(points: np.ndarray, voxel_m: float) -> np.ndarray:
    """(N, 3) points -> (M, 3): the mean of the points in each occupied voxel of size `voxel_m`, in voxel order."""
    if len(points) == 0:
        return points
    keys = np.floor((points - points.min(axis=0)) / voxel_m + 0.5).astype(np.int64)  # outer walls lie mid-voxel
    _, owner, counts = np.unique(row_keys(keys), return_inverse=True, return_counts=True)
    return np.column_stack([np.bincount(owner, points[:, axis]) for axis in range(3)]) / counts[:, None]
