"""Status and covariance of every tracked frame: `tracking.json`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from ..core.errors import DataError
from ..core.files import read_bytes, write_text
from ..core.json_values import first_problem

Status = Literal["tracked", "weak", "lost", "relocalised"]


class TrackedFrame(BaseModel):
    """One frame of the tracker.

    status      tracked: well determined; weak: some direction is determined by the motion model alone;
                lost: no pose, nothing is integrated; relocalised: tracked again by a search in all keyframes
    covariance  (6, 6) of the small motion x in T_world_camera @ exp(x): 3 of translation, metres, then 3 of
                rotation, radians, in the axes of the camera, relative to the first keyframe, for which it is zero;
                None if the camera is lost
    matches     features that agree with the pose; 0 if it comes from the surface alone
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    index: int
    timestamp: float
    status: Status
    matches: int = 0
    covariance: list[list[float]] | None = None


class TrackingRecord(BaseModel):
    """`tracking.json` of a run: every frame that was tracked or lost, in order."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    frames: tuple[TrackedFrame, ...]

    def save(self, path: Path) -> None:
        """Write the file. Raises RunError."""
        write_text(path, self.model_dump_json() + "\n")

    @staticmethod
    def of(frames: Sequence[TrackedFrame], spread: dict[int, np.ndarray]) -> TrackingRecord:
        """`frames` with covariances relative to the first frame: `spread` holds those (6, 6) of keyframes, by index.

        Those of the other frames are relative to the map, that is to the last keyframe before them.
        """
        known, placed = np.zeros((6, 6)), []
        for frame in frames:
            known = spread.get(frame.index, known)
            if frame.covariance is not None:
                whole = known if frame.index in spread else known + frame.covariance
                placed.append(frame.model_copy(update={"covariance": whole.tolist()}))
            else:
                placed.append(frame)
        return TrackingRecord(frames=tuple(placed))

    @staticmethod
    def load(path: Path) -> TrackingRecord:
        """Read the file. Raises DataError."""
        try:
            return TrackingRecord.model_validate_json(read_bytes(path))
        except (OSError, ValidationError) as error:
            raise DataError(
                f"cannot read {path}: {first_problem(error)}; redo it with `uncle map --track --overwrite`"
            ) from error

    def counts(self) -> dict[str, int]:
        """How many frames have each status."""
        return {status: sum(f.status == status for f in self.frames) for status in get_args(Status)}

    def lost_ranges(self) -> list[tuple[int, int]]:
        """First and last index of each stretch of lost frames."""
        ranges: list[tuple[int, int]] = []
        previous_lost = False
        for frame in self.frames:
            if frame.status == "lost":
                if previous_lost:
                    ranges[-1] = (ranges[-1][0], frame.index)
                else:
                    ranges.append((frame.index, frame.index))
            previous_lost = frame.status == "lost"
        return ranges
