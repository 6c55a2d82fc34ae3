"""Memory of `uncle map` against what its surface needs: a room, one of its frames far off, a corridor; see README.md.

Memory is taken as a fixed part and a part for each block of the map. Both are measured: with the room as it is, and
with the first quarter of the corridor.
"""

from __future__ import annotations

import argparse
import shlex
import shutil
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import carry_out
from uncle.datasets import open_dataset
from uncle.recon.core.errors import UncleError
from uncle.recon.core.events import Event, Warn
from uncle.recon.core.frame import Frame, Recording
from uncle.recon.evaluation.bench.process import Record, map_facts, uncle
from uncle.recon.evaluation.bench.tables import markdown_table
from uncle.recon.run.directory import RunDirectory
from uncle.recon.stages.map import load_field
from uncle.recon.stages.preprocess import preprocess_run

WAY = np.array([1.0, 0.3, 0.1])  # of the frame that is moved: along no axis
NAMED = "far from all other frames"
ROOM, QUARTER = "room", "corridor, first quarter"


class Job(NamedTuple):
    """One map: of the first `share` of the frames of a data set, the middle one moved by `moved_m` metres."""

    case: str
    dataset: str
    share: float
    moved_m: float
    map_options: str

    @property
    def key(self) -> str:
        return "|".join(map(str, self))


class FarFrame:
    """A recording in which the pose of one frame is wrong by `distance_m` metres."""

    def __init__(self, recording: Recording, index: int, distance_m: float) -> None:
        self._recording, self._index, self._distance_m = recording, index, distance_m

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, index: int) -> Frame:
        raise NotImplementedError("the parts of a frame are read one by one")

    def pose(self, index: int) -> np.ndarray | None:
        pose = self._recording.pose(index)
        if pose is None or index != self._index:
            return pose
        moved = pose.copy()
        moved[:3, 3] += self._distance_m * WAY / np.linalg.norm(WAY)
        return moved


def plan(room: Path, corridor: Path, moved_m: Sequence[float], map_options: str) -> list[Job]:
    """The room, the room with a frame moved by each distance, and a quarter, a half and all of the corridor."""
    cases = [(ROOM, room, 1.0, 0.0)]
    cases += [(f"room, a frame {distance / 1000:g} km off", room, 1.0, distance) for distance in moved_m]
    cases += [(QUARTER, corridor, 0.25, 0.0), ("corridor, half", corridor, 0.5, 0.0), ("corridor", corridor, 1.0, 0.0)]
    return [Job(case, str(dataset), share, distance, map_options) for case, dataset, share, distance in cases]


def execute(job: Job, work: Path) -> Record:
    """Map one case. Raises DataError, RunError."""
    recording: Any = open_dataset(Path(job.dataset))
    count = max(1, round(job.share * len(recording)))
    if job.moved_m:
        recording = FarFrame(recording, count // 2, job.moved_m)
    warnings: list[str] = []

    def note(event: Event) -> None:
        warnings.extend([event.text] if isinstance(event, Warn) else [])

    shutil.rmtree(work, ignore_errors=True)
    run = RunDirectory(work)
    preprocess_run(recording, run, dataset=Path(job.dataset), frames=slice(count), force=True, on_event=note)
    uncle("map", "--run", work, *shlex.split(job.map_options))
    return job._asdict() | {
        "frames": count,
        "blocks": len(load_field(run).grid.blocks),
        "peak_memory_mb": map_facts(work)["peak_memory_mb"],
        "named": [text for text in warnings if NAMED in text],
    }


def needs(records: Sequence[Record]) -> tuple[float, float]:
    """MB that every map needs, and MB for each block, from the room as it is and the first quarter of the corridor."""
    first, second = (next(r for r in records if r["case"] == case) for case in (ROOM, QUARTER))
    slope = (second["peak_memory_mb"] - first["peak_memory_mb"]) / (second["blocks"] - first["blocks"])
    return first["peak_memory_mb"] - slope * first["blocks"], slope


def markdown(records: Sequence[Record]) -> str:
    """One row for each case."""
    fixed, slope = needs(records)
    rows = []
    for record in records:
        needed, peak = fixed + slope * record["blocks"], record["peak_memory_mb"]
        named = "; ".join(record["named"]) or "-"
        sizes = [str(record["frames"]), str(record["blocks"]), f"{peak:.0f}", f"{needed:.0f}"]
        rows.append([record["case"], *sizes, f"{peak / needed:.2f}", named])
    header = ["case", "frames", "blocks", "peak MB", "its surface needs MB", "ratio", "named by `uncle preprocess`"]
    return "\n".join(markdown_table(header, rows))


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("room", type=Path)
    parser.add_argument("corridor", type=Path)
    parser.add_argument("--km", nargs="+", type=float, default=[1, 100], help="distances of the far frame [1 100]")
    parser.add_argument("--map-options", default="", help="of `uncle map`, in one string")
    parser.add_argument("--out", type=Path, default=Path("bench-out"), help="results and run directories [bench-out]")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run what is missing and print the table; 1 if a case failed."""
    options = parse(arguments)
    moved_m = [1000 * distance for distance in options.km]
    jobs = plan(options.room.resolve(), options.corridor.resolve(), moved_m, options.map_options)
    options.out.mkdir(parents=True, exist_ok=True)
    once = partial(execute, work=options.out / "memory-run")
    records, failed = carry_out(jobs, options.out / "memory.json", once, lambda job, record: True)
    if not failed:
        print(markdown([records[job.key] for job in jobs]))
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
