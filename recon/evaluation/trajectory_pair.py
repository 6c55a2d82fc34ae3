"""All that is known of the way of a camera: estimated poses, true poses, and what the tracker says of each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ..core.errors import DataError
from ..core.trajectory import Trajectory
from ..run.directory import RunDirectory
from ..run.tracking_record import TrackingRecord
from .trajectory_metrics import MatchedPoses, has_clock


@dataclass(frozen=True)
class CameraPath:
    """`reference` is None without a truth, `record` where nothing was tracked."""

    estimate: Trajectory
    reference: Trajectory | None = None
    record: TrackingRecord | None = None

    @staticmethod
    def of_run(run: RunDirectory, *, with_record: bool = True) -> CameraPath:
        """Raises DataError if the run has no trajectory, or a file that is asked for cannot be read."""
        if not run.trajectory_path.is_file():
            raise DataError(f"there is no trajectory yet; run `uncle map --run {run.root}`")
        estimate = Trajectory.load(run.trajectory_path)
        true, record = run.reference_trajectory_path, run.tracking_path
        reference = Trajectory.load(true) if true.is_file() else None
        has_record = with_record and record.is_file()
        return CameraPath(estimate, reference, TrackingRecord.load(record) if has_record else None)

    @staticmethod
    def of_files(estimate: Path, reference: Path) -> CameraPath:
        """Two files of TUM text. Raises DataError."""
        return CameraPath(Trajectory.load(estimate), Trajectory.load(reference))

    @cached_property
    def posed(self) -> Trajectory:
        """The estimate without poses that are not finite, in the order of time. Raises DataError if none is left."""
        finite = finite_poses(self.estimate)
        if len(finite) == 0:
            raise DataError("the trajectory holds no finite pose")
        return finite

    @cached_property
    def matched(self) -> MatchedPoses | None:
        """None without a truth at the same times."""
        if self.reference is None:
            return None
        try:
            return MatchedPoses.of(self.estimate, self.reference)
        except DataError:
            return None

    @cached_property
    def has_clock(self) -> bool:
        return has_clock(self.posed.timestamps)

    @cached_property
    def start_time(self) -> float:
        """Time stamp of the first frame, with or without a pose."""
        recorded = [frame.timestamp for frame in self.record.frames[:1]] if self.record is not None else []
        return min([float(self.posed.timestamps[0]), *recorded])

    @cached_property
    def lost_spans(self) -> list[tuple[float, float]]:
        """From the last time stamp before to the first after each stretch of lost frames, or its own at an end."""
        if self.record is None:
            return []
        spans: list[tuple[float, float]] = []
        previous, open_since = None, None
        for frame in self.record.frames:
            if frame.status == "lost" and open_since is None:
                open_since = frame.timestamp if previous is None else previous
            elif frame.status != "lost" and open_since is not None:
                spans.append((open_since, frame.timestamp))
                open_since = None
            previous = frame.timestamp
        return spans if open_since is None or previous is None else [*spans, (open_since, previous)]


def finite_poses(trajectory: Trajectory) -> Trajectory:
    """The finite poses in the order of time."""
    finite = np.isfinite(trajectory.T_world_camera).all(axis=(1, 2)) & np.isfinite(trajectory.timestamps)
    order = np.flatnonzero(finite)[np.argsort(trajectory.timestamps[finite], kind="stable")]
    return Trajectory(trajectory.timestamps[order], trajectory.T_world_camera[order])
