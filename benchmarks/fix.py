"""What `uncle preprocess --fix` makes of a recording with an error: the map against that of the recording as it is.

See README.md. The errors are those of inspection.py, made in memory.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from inspection import CORRUPTIONS
from uncle.datasets.registry import open_dataset
from uncle.recon.core.errors import DataError, UncleError
from uncle.recon.core.frame import Recording
from uncle.recon.evaluation.surface_metrics import EvaluationSettings
from uncle.recon.methods.registry import method_spec
from uncle.recon.run.directory import RunDirectory
from uncle.recon.stages.evaluate import evaluate_run
from uncle.recon.stages.map import map_run
from uncle.recon.stages.mesh import mesh_run
from uncle.recon.stages.preprocess import STAGE, preprocess_run

HOLD_OUT = 10
MAX_F_LOSS = 1.0  # points
MAX_L1_RATIO = 1.05


@dataclass(frozen=True)
class Result:
    """Scores of a map: F at 5 cm in points, None without a true surface; depth L1 at held-out frames, metres."""

    correction: str
    f_score: float | None
    l1_m: float

    def is_as_good_as(self, other: Result) -> bool:
        """Whether this map loses at most `MAX_F_LOSS`, or `MAX_L1_RATIO` without a true surface."""
        if self.f_score is not None and other.f_score is not None:
            return self.f_score >= other.f_score - MAX_F_LOSS
        return self.l1_m <= MAX_L1_RATIO * other.l1_m


def reconstruct(recording: Recording, dataset: Path, sensors: Sequence[str], method: str, run: RunDirectory) -> Result:
    """The chain with `--fix`. Raises DataError where the error cannot be mended."""
    preprocess_run(recording, run, dataset=dataset, sensors=tuple(sensors) or None, fix=True, overwrite=True)
    correction = run.load_manifest().stages[STAGE].facts["correction"]
    map_run(run, method_spec(method).configure([], sensors=tuple(sensors), hold_out=HOLD_OUT), overwrite=True)
    mesh_run(run, overwrite=True)
    metrics = evaluate_run(run, EvaluationSettings(views=0)).metrics
    f_score = None if metrics.surface is None else 100 * metrics.surface.mesh.scores[0].f_score
    errors = [one.l1_m for one in metrics.held_out.values() if one.l1_m is not None]
    if not errors:
        raise DataError("no surface is seen from the frames that were held out")
    text = ", ".join(f"{name} {value:.4g}" if value is not True else name for name, value in correction.items())
    return Result(text, f_score, sum(errors) / len(errors))


def compare(dataset: Path, sensors: Sequence[str], only: Sequence[str] | None, method: str) -> list[bool]:
    """Print a line for each error; whether the map with its correction is as good as that without the error."""
    stated, undisturbed, verdicts = open_dataset(dataset), None, []
    for corruption in CORRUPTIONS:
        if corruption.check and only and corruption.name not in only:
            continue
        recording = corruption.make(stated)
        if recording is None:
            continue
        with tempfile.TemporaryDirectory(prefix="uncle-fix-") as folder:
            try:
                result = reconstruct(recording, dataset, sensors, method, RunDirectory(Path(folder) / "run"))
            except DataError as error:
                print(f"| {dataset.name} | {corruption.name} | not mended: {error} | | | |", flush=True)
                continue
        undisturbed = undisturbed or result
        f_score = "" if result.f_score is None else f"{result.f_score:.2f}"
        is_good = result.is_as_good_as(undisturbed)
        verdicts.append(is_good)
        print(f"| {dataset.name} | {corruption.name} | {result.correction} | {f_score} | {100 * result.l1_m:.3f} | "
              f"{'yes' if is_good else '**no**'} |", flush=True)  # fmt: skip
    return verdicts


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit code 1 if a map is worse than that of the recording as it is."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("datasets", nargs="+", type=Path, metavar="DATASET")
    parser.add_argument("--sensors", nargs="+", default=(), metavar="NAME")
    parser.add_argument("--only", nargs="+", metavar="CORRUPTION", help="only these errors, by name")
    parser.add_argument("--method", default="uncle")
    options = parser.parse_args(arguments)
    print("| data set | error | correction | F 5 cm | held-out L1 cm | as good |\n|" + "---|" * 6, flush=True)
    verdicts = [
        verdict
        for dataset in options.datasets
        for verdict in compare(dataset, options.sensors, options.only, options.method)
    ]
    print(f"\n{sum(verdicts)} of {len(verdicts)} maps are as good as that of the recording as it is")
    return int(not all(verdicts))


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
