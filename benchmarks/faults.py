"""Let a sensor fail in the middle of a recording and see what the map loses; see benchmarks/README.md."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import torch
from common import carry_out
from torch import Tensor
from uncle.datasets import open_dataset
from uncle.recon.core.errors import UncleError
from uncle.recon.core.frame import Frame, Recording
from uncle.recon.evaluation.bench.process import Record, new_run, sensor_options, uncle
from uncle.recon.evaluation.bench.scores import surface_scores
from uncle.recon.evaluation.bench.tables import cell, markdown_table
from uncle.recon.run.directory import RunDirectory
from uncle.recon.stages.preprocess import preprocess_run

FAULTS = ("none", "zero", "frozen", "shifted")
SHIFT_M = 0.2
METHODS = {
    "uncle": ["--method", "uncle"],
    "unchecked": ["--method", "uncle", "--set", "fault_detection.enabled=false"],
    "tsdf": ["--method", "tsdf"],
}
COLUMNS = (("F 5 cm %", "f_score_5cm", 100, 2, False), ("F 2 cm %", "f_score_2cm", 100, 2, False))


class Job(NamedTuple):
    """One map. `sensors` is joined by +; `fault` meets `sensor` from frame `start` on."""

    dataset: str
    sensors: str
    method: str
    fault: str
    sensor: str
    start: int
    seed: int

    @property
    def key(self) -> str:
        return "|".join(map(str, self))


class FaultyRecording:
    """A recording, one sensor of which fails: reads nothing, repeats its last image, or reads `SHIFT_M` too far."""

    def __init__(self, recording: Recording, sensor: str, fault: str, start: int) -> None:
        self._recording, self._sensor, self._fault, self._start = recording, sensor, fault, start

    def __getattr__(self, name: str) -> Any:
        return getattr(self._recording, name)

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, index: int) -> Frame:
        raise NotImplementedError("the parts of a frame are read one by one")

    def depth(self, index: int, sensor: str) -> Tensor:
        if sensor != self._sensor or index < self._start:
            return self._recording.depth(index, sensor)
        if self._fault == "frozen":
            return self._recording.depth(self._start - 1, sensor)
        depth = self._recording.depth(index, sensor)
        if self._fault == "zero":
            return torch.zeros_like(depth)
        return torch.where(depth > 0, depth + SHIFT_M, 0.0)


def plan(dataset: str, sensors: str, methods: list[str], faults: list[str], faulty: list[str], start: int, seed: int):
    """Jobs in order; the recording without a fault comes first."""
    cases = [("none", "", 0)] * ("none" in faults)
    cases += [(fault, sensor, start) for fault in faults if fault != "none" for sensor in faulty]
    return [Job(dataset, sensors, method, *case, seed) for case in cases for method in methods]


def execute(job: Job, dataset: Path, out: Path) -> Record:
    """Map and score one case. Raises RunError."""
    base, run = out / f"{job.fault}-{job.sensor or 'any'}-{job.start}", out / "work"
    recording = open_dataset(dataset)
    sensors = [*job.sensors.split("+"), *(["gt"] if "gt" in recording.sensors else [])]
    faulty = FaultyRecording(recording, job.sensor, job.fault, job.start) if job.fault != "none" else recording
    preprocess_run(faulty, RunDirectory(base), dataset=dataset, sensors=sensors)
    new_run(base, run)
    uncle("map", "--run", run, *sensor_options(job.sensors), *METHODS[job.method], "--seed", job.seed, "--overwrite")
    uncle("mesh", "--run", run, "--overwrite")
    uncle("eval", "--run", run, "--json")
    metrics = json.loads((run / "metrics.json").read_text())
    found = json.loads((run / "sensors.json").read_text())["sensors"] if (run / "sensors.json").exists() else {}
    messages = [sentence for facts in found.values() for sentence in facts["sentences"]]
    return job._asdict() | surface_scores(metrics["surface"]) | {"messages": messages}


def markdown(records: Iterable[Record]) -> str:
    """One row for each case; what a fault costs is the difference to the same map without one."""
    records = list(records)
    whole = {(r["dataset"], r["sensors"], r["method"], r["seed"]): r for r in records if r["fault"] == "none"}
    rows = []
    for record in records:
        sound = whole.get((record["dataset"], record["sensors"], record["method"], record["seed"]))
        cost = f"{(sound['f_score_5cm'] - record['f_score_5cm']) * 100:.2f}" if sound and sound is not record else "-"
        case = [record["sensors"], record["method"], record["fault"], record["sensor"] or "-"]
        rows.append([*case, *(cell([record], *column[1:]) for column in COLUMNS), cost, "; ".join(record["messages"])])
    header = ["sensors", "method", "fault", "of", *(column[0] for column in COLUMNS), "costs, F 5 cm", "reported"]
    return "\n".join(markdown_table(header, rows))


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--sensors", nargs="+", required=True, help="sensors that are mapped together")
    parser.add_argument("--fault", nargs="+", choices=FAULTS, default=list(FAULTS), help="what goes wrong [all]")
    parser.add_argument("--sensor", nargs="+", help="sensors that it happens to, one at a time [each]")
    parser.add_argument("--start", type=int, help="first frame of the fault [the middle]")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=["uncle", "tsdf"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("bench-out"), help="results and run directories [bench-out]")
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    sensors, name = "+".join(options.sensors), options.dataset.resolve().name
    start = options.start if options.start is not None else len(open_dataset(options.dataset)) // 2
    faulty = options.sensor or options.sensors
    jobs = plan(name, sensors, options.methods, [*dict.fromkeys(["none", *options.fault])], faulty, start, options.seed)
    once = partial(execute, dataset=options.dataset, out=options.out / name / sensors)
    options.out.mkdir(parents=True, exist_ok=True)
    records, failed = carry_out(jobs, options.out / "faults.json", once, lambda job, record: True)
    print(markdown(record for key, record in records.items() if key in {job.key for job in jobs}))
    return 1 if failed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
