"""Whether the voxel size that is chosen for a recording suits it; see README.md.

The recording is also taken as one of a smaller scene: its depth, poses and true surface are scaled.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from uncle.datasets.registry import open_dataset
from uncle.recon.core.correction import CorrectedRecording, Correction
from uncle.recon.core.errors import DataError, UncleError
from uncle.recon.core.mesh import Mesh
from uncle.recon.evaluation.surface_metrics import EvaluationSettings, score_surface
from uncle.recon.methods.registry import method_spec
from uncle.recon.run.directory import RunDirectory
from uncle.recon.stages.map import load_field, map_run
from uncle.recon.stages.mesh import mesh_run
from uncle.recon.stages.preprocess import preprocess_run

THRESHOLDS_M = (0.05, 0.02)  # at scale 1


def scaled_mesh(mesh: Mesh, scale: float) -> Mesh:
    """The surface of the scene, scaled about the origin."""
    return Mesh(mesh.vertices * scale, mesh.faces)


def trial(dataset: Path, sensors: Sequence[str], scale: float, method: str, folder: Path) -> None:
    """Map the scene at `scale` with the chosen voxel size, with half and twice of it, and with that of rooms."""
    stated = open_dataset(dataset)
    if stated.reference_mesh is None:
        raise DataError(f"{dataset} has no true surface to compare with")
    recording = CorrectedRecording(stated, Correction(depth_factor=scale, translation_factor=scale))
    reference = scaled_mesh(Mesh.load(stated.reference_mesh), scale)
    run = RunDirectory(folder / f"scale-{scale:g}")
    preprocess_run(recording, run, dataset=dataset, sensors=tuple(sensors) or None, force=True)
    options = EvaluationSettings(thresholds_m=tuple(scale * one for one in THRESHOLDS_M), views=0)
    sizes, chosen = {"chosen": 0.0}, 0.0
    while sizes:
        name, size = sizes.popitem()
        started = time.perf_counter()
        config = method_spec(method).configure([f"fusion.voxel_size_m={size:g}"], sensors=tuple(sensors))
        map_run(run, config, overwrite=True)
        seconds = time.perf_counter() - started
        grid = load_field(run).grid
        if not chosen:
            chosen = grid.voxel_size_m
            sizes = {"double": 2 * chosen, "half": chosen / 2} | ({"room": 0.02} if chosen < 0.02 else {})
        mesh_run(run, overwrite=True)
        scores = score_surface(Mesh.load(run.mesh_path), reference, options).mesh
        f_scores = " / ".join(f"{100 * one.f_score:.1f}" for one in scores.scores)
        print(f"| {dataset.name} | {scale:g} | {name} | {1000 * grid.voxel_size_m:g} | {f_scores} | "
              f"{grid.rows / 1e6:.1f} | {seconds:.0f} |", flush=True)  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a line for each scale and voxel size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path, metavar="DATASET")
    parser.add_argument("--sensors", nargs="+", default=(), metavar="NAME")
    parser.add_argument("--scales", nargs="+", type=float, default=(1.0, 0.25), metavar="FACTOR")
    parser.add_argument("--method", default="uncle")
    options = parser.parse_args(arguments)
    print(
        "| data set | scale | voxel | mm | F 5 / 2 cm x scale | million samples | map s |\n|" + "---|" * 7, flush=True
    )
    with tempfile.TemporaryDirectory(prefix="uncle-voxel-") as folder:
        for scale in options.scales:
            trial(options.dataset, options.sensors, scale, options.method, Path(folder))
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
