"""The path of a camera: estimated poses, true poses, and the tracking record."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from ..core.errors import DataError
from ..core.trajectory import Trajectory
from ..run.directory import RunDirectory
from ..run.tracking_record import TrackingRecord
from .trajectory_metrics import MatchedPoses, has_clock


@dataclass(frozen=True)
class CameraPath:
    """`reference` (true poses) is None where they are unknown, `record` where the poses were given."""

    estimate: Trajectory
    reference: Trajectory | None = None
    record: TrackingRecord | None = None

    @staticmethod
    def of_run(run: RunDirectory, *, with_record: bool = True) -> CameraPath:
        """The path of a run. Raises DataError if it has no trajectory, or a file cannot be read."""
        if not run.trajectory_path.is_file():
            raise DataError(f"{run.root} has no trajectory; make it with `uncle map --run {run.root}`")
        estimate = run.load_trajectory()
        has_reference = run.reference_trajectory_path.is_file()
        reference = run.load_trajectory(run.reference_trajectory_path) if has_reference else None
        has_record = with_record and run.tracking_path.is_file()
        return CameraPath(estimate, reference, TrackingRecord.load(run.tracking_path) if has_record else None)

    @cached_property
    def posed(self) -> Trajectory:
        """The finite poses of the estimate, in order of time. Raises DataError if there are none."""
        finite = self.estimate.finite()
        if len(finite) == 0:
            raise DataError("the trajectory holds no finite pose")
        return finite

    @cached_property
    def matched(self) -> MatchedPoses | None:
        """Estimated and true poses at the same times; None if there are none."""
        if self.reference is None:
            return None
        try:
            return MatchedPoses.of(self.estimate, self.reference)
        except DataError:
            return None

    @cached_property
    def has_clock(self) -> bool:
        """Whether time stamps are seconds, not frame numbers."""
        return has_clock(self.posed.timestamps)

    @cached_property
    def start_time(self) -> float:
        """Time stamp of the first frame, with or without a pose."""
        recorded = [frame.timestamp for frame in self.record.frames[:1]] if self.record is not None else []
        return min([float(self.posed.timestamps[0]), *recorded])

    @cached_property
    def lost_spans(self) -> list[tuple[float, float]]:
        """Start and end time of each range of lost frames: the time stamps of the frames around it, where there are."""
        if self.record is None:
            return []
        spans: list[tuple[float, float]] = []
        previous: float | None = None
        open_since: float | None = None
        for frame in self.record.frames:
            if frame.status == "lost" and open_since is None:
                open_since = frame.timestamp if previous is None else previous
            elif frame.status != "lost" and open_since is not None:
                spans.append((open_since, frame.timestamp))
                open_since = None
            previous = frame.timestamp
        return spans if open_since is None or previous is None else [*spans, (open_since, previous)]
