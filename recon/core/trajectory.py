"""Camera trajectories and the TUM text format (`timestamp tx ty tz qx qy qz qw`, T_world_camera)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .files import write_text
from .pose import MAX_POSITION_M
from .text import read_table


@dataclass(frozen=True)
class Trajectory:
    """timestamps (N,) seconds, strictly increasing; T_world_camera (N, 4, 4) float64."""

    timestamps: np.ndarray
    T_world_camera: np.ndarray

    def __len__(self) -> int:
        return len(self.timestamps)

    def finite(self) -> Trajectory:
        """The poses that are finite and have a finite time stamp, in order of time."""
        finite = np.isfinite(self.T_world_camera).all(axis=(1, 2)) & np.isfinite(self.timestamps)
        order = np.flatnonzero(finite)[np.argsort(self.timestamps[finite], kind="stable")]
        return Trajectory(self.timestamps[order], self.T_world_camera[order])

    def moved(self, offset_m: Sequence[float]) -> Trajectory:
        """The trajectory with `offset_m` (3,) added to all positions."""
        if not any(offset_m):
            return self
        poses = self.T_world_camera.copy()
        poses[:, :3, 3] += offset_m
        return Trajectory(self.timestamps, poses)

    def save(self, path: Path) -> None:
        """Write TUM text that `evo_ape tum` reads. Raises RunError."""
        quaternions = Rotation.from_matrix(self.T_world_camera[:, :3, :3]).as_quat()
        rows = np.column_stack([self.T_world_camera[:, :3, 3], quaternions])
        lines = [f"{t:.6f} " + " ".join(f"{x:.9f}" for x in row) for t, row in zip(self.timestamps, rows, strict=True)]
        write_text(path, "\n".join(["# timestamp tx ty tz qx qy qz qw", *lines]) + "\n")

    @staticmethod
    def load(path: Path) -> Trajectory:
        """Read TUM text; a pose that cannot be one is not finite. Raises DataError naming the first bad line."""
        expected = "8 numbers `timestamp tx ty tz qx qy qz qw`"
        table = np.array(read_table(path, lambda widths: set(widths) == {8}, expected).rows)
        poses = np.tile(np.eye(4), (len(table), 1, 1))
        with np.errstate(over="ignore"):  # damaged numbers, which the next line leaves out
            norms = np.linalg.norm(table[:, 4:], axis=1)
        valid = np.isfinite(table).all(axis=1) & (norms > 1e-6) & (norms < MAX_POSITION_M)
        valid &= (np.abs(table[:, 1:4]) < MAX_POSITION_M).all(axis=1)
        poses[valid, :3, :3] = Rotation.from_quat(table[valid, 4:]).as_matrix()
        poses[:, :3, 3] = table[:, 1:4]
        poses[~valid] = np.nan
        return Trajectory(table[:, 0], poses)
