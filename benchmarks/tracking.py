"""Track one sequence with several systems in turns: accuracy, speed, memory; see benchmarks/README.md."""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import tomllib
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from common import carry_out
from scipy.spatial.transform import Rotation
from uncle.datasets.seven_scenes import T_COLOR_DEPTH
from uncle.recon.core.errors import DataError, RunError, UncleError
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.evaluation.bench.process import (
    LAUNCHER,
    Record,
    map_facts,
    new_run,
    run_process,
    sensor_options,
    uncle,
)
from uncle.recon.evaluation.bench.scores import surface_scores
from uncle.recon.evaluation.bench.tables import cell, markdown_table, ratio
from uncle.recon.evaluation.trajectory_metrics import evaluate_trajectory
from uncle.recon.run.tracking_record import TrackingRecord

BASELINE = "open3d"
SYSTEMS = (
    "uncle",
    BASELINE,
    "open3d-hybrid",
    "given",
)  # ours, Open3D's SLAM twice, ours with the poses of the data
REPETITIONS = 3  # at most, of systems other than ours: they know no seed, or it does not decide where the camera is
DEGREES = 180 / 3.141592653589793
# heading, key in the record, factor, digits, whether minimum and maximum are shown
COLUMNS = (
    ("ATE as it is cm", "ate_m", 100, 2, True), ("ATE aligned cm", "ate_aligned_m", 100, 2, True),
    ("ATE to SfM cm", "ate_sfm_m", 100, 2, True),
    ("RPE cm", "rpe_translation_m", 100, 2, False), ("RPE deg", "rpe_rotation_rad", DEGREES, 2, False),
    ("largest step error cm", "rpe_max_m", 100, 2, False), ("frames with a pose %", "posed", 100, 1, False),
    ("tracked", "tracked", 1, 0, False), ("weak", "weak", 1, 0, False), ("lost", "lost", 1, 0, True),
    ("frames/s", "frames_per_s", 1, 2, False), ("frames/s, loop alone", "loop_frames_per_s", 1, 2, False),
    ("peak MB", "peak_memory_mb", 1, 0, False),
    ("F 5 cm %", "f_score_5cm", 100, 2, True), ("F 2 cm %", "f_score_2cm", 100, 2, True),
)  # fmt: skip


class Job(NamedTuple):
    """One system once over the sequence. `seed` counts the repetitions where the system knows no seed."""

    dataset: str
    frames: str  # START:STOP; "" are all
    sensors: str  # joined by +; "" are those that `uncle map` takes by itself
    system: str
    voxel_m: float  # 0: the default of `uncle map`
    seed: int

    @property
    def key(self) -> str:
        voxel = f"{self.voxel_m:g}" if self.voxel_m else "default"
        return f"{self.dataset}|{self.frames or 'all'}|{self.sensors or 'all'}|{self.system}|{voxel}|{self.seed}"


def plan(
    dataset: str, frames: str, sensor_sets: list[str], systems: list[str], open3d_voxels_m: list[float], seeds: int
) -> list[Job]:
    """Jobs in order: systems take turns, so that a change in the load of the machine meets all of them."""
    voxels = {system: open3d_voxels_m if system.startswith("open3d") else [0.0] for system in systems}
    return [
        Job(dataset, frames, sensors, system, voxel_m, turn)
        for sensors in sensor_sets
        for turn in range(seeds)
        for system in systems
        for voxel_m in voxels[system]
        if system == "uncle" or turn < REPETITIONS
    ]


# --- one pass --------------------------------------------------------------------------------------------------------
def execute(job: Job, base: Path, run: Path, with_mesh: bool, sfm_poses: Path | None) -> Record:
    """One pass in the new run directory `run`, which borrows the frames of `base`. Raises RunError."""
    new_run(base, run)
    costs = _open3d(job, run, with_mesh) if job.system.startswith("open3d") else _uncle(job, run, with_mesh)
    frames = len(json.loads((run / "frames" / "frames.json").read_text()))
    costs |= {"frames_per_s": frames / costs["wall_s"], "loop_frames_per_s": frames / sum(costs["seconds"].values())}
    scores = errors(run, frames) | (_surface(run) if with_mesh else {})
    if sfm_poses is not None and scores["posed"]:
        scores["ate_sfm_m"] = error_to_sfm(Trajectory.load(run / "trajectory.txt"), sfm_poses)
    return job._asdict() | costs | {"frame_count": frames, "with_mesh": with_mesh} | scores


def _uncle(job: Job, run: Path, with_mesh: bool) -> Record:
    """Costs and settings of `uncle map`, with tracking unless the poses are given."""
    track = ["--track"] if job.system == "uncle" else []
    wall_s = uncle("map", "--run", run, "--overwrite", *track, *sensor_options(job.sensors), "--seed", job.seed)
    if with_mesh:
        uncle("mesh", "--run", run, "--overwrite")
    facts, config = map_facts(run), tomllib.loads((run / "config.toml").read_text())
    costs = {"wall_s": wall_s, "seconds": facts["seconds"], "peak_memory_mb": facts["peak_memory_mb"]}
    return costs | {"used_voxel_m": config["fusion"]["voxel_size_m"]}


def _open3d(job: Job, run: Path, with_mesh: bool) -> Record:
    """The same of Open3D's SLAM; taking the mesh out of it is not part of the time, as with ours."""
    script = Path(__file__).with_name("open3d_slam.py")
    options = ["--method", job.system, "--voxel", job.voxel_m, *sensor_options(job.sensors)]
    wall_s, _ = run_process(script.name, [sys.executable, script, run, *options, *(["--mesh"] if with_mesh else [])])
    facts = json.loads((run / "open3d.json").read_text())
    costs = {"wall_s": wall_s - facts["mesh_seconds"], "seconds": facts["seconds"]}
    costs |= {"peak_memory_mb": facts["peak_memory_mb"], "used_voxel_m": job.voxel_m}
    return costs | {"lost": len(facts["lost"]), "tracked": facts["frames"] - len(facts["lost"])}


def errors(run: Path, frames: int) -> Record:
    """Trajectory errors of `run` over the frames that have a pose, and how many of its `frames` those are."""
    found: Record = {"posed": 0.0}
    try:
        estimate = Trajectory.load(run / "trajectory.txt")
        found["posed"] = len(estimate) / frames
        scored = evaluate_trajectory(estimate, Trajectory.load(run / "trajectory_gt.txt"))
        found |= {"ate_m": scored.ate_m.rmse, "ate_aligned_m": scored.ate_aligned_m.rmse}
        if scored.rpe_translation_m is not None:
            found |= {"rpe_translation_m": scored.rpe_translation_m.rmse, "rpe_max_m": scored.rpe_translation_m.max}
            found |= {"rpe_rotation_rad": scored.rpe_rotation_rad.rmse}
    except DataError:
        pass  # nothing to compare: every frame is lost, or the data set has no poses
    if (run / "tracking.json").exists():
        states = [frame.status for frame in TrackingRecord.load(run / "tracking.json").frames]
        found |= {status: states.count(status) for status in ("weak", "lost")}
        found["tracked"] = states.count("tracked") + states.count("relocalised")
    return found


def error_to_sfm(estimate: Trajectory, path: Path) -> float:
    """ATE, aligned, in metres, of the colour camera of 7-Scenes against structure from motion of its images.

    estimate  depth camera; time stamps are frame numbers
    path      a line for each colour image: frame, qw qx qy qz tx ty tz (camera from world, as COLMAP writes it), ...

    Raises DataError if no frame is in both.
    """
    table = np.loadtxt(path, ndmin=2)
    T_camera_world = np.tile(np.eye(4), (len(table), 1, 1))
    T_camera_world[:, :3, :3] = Rotation.from_quat(table[:, [2, 3, 4, 1]]).as_matrix()
    T_camera_world[:, :3, 3] = table[:, 5:8]
    truth = Trajectory(table[:, 0], np.linalg.inv(T_camera_world))
    color = Trajectory(estimate.timestamps, estimate.T_world_camera @ np.linalg.inv(T_COLOR_DEPTH))
    return evaluate_trajectory(color, truth).ate_aligned_m.rmse


def _surface(run: Path) -> Record:
    """Scores of RUN/mesh.ply where the cameras saw; without a single triangle F is 0."""
    reference = json.loads((run / "manifest.json").read_text())["reference_mesh"]
    if not (run / "mesh.ply").exists():
        return {"f_score_5cm": 0.0, "f_score_2cm": 0.0}
    options = ["--cull", run, "--views", 0, "--json"]
    return surface_scores(
        json.loads(run_process("uncle eval", [*LAUNCHER, "eval", run / "mesh.ply", reference, *options])[1])
    )


# --- the table -------------------------------------------------------------------------------------------------------
def groups(records: Iterable[Record]) -> dict[tuple[str, ...], list[Record]]:
    """Records that differ in the seed alone, by (data set, frames, sensors, system, voxel in cm)."""
    found: dict[tuple[str, ...], list[Record]] = {}
    for record in records:
        names = (record["dataset"], record["frames"] or "all", record["sensors"] or "all", record["system"])
        found.setdefault((*names, f"{record['used_voxel_m'] * 100:g}"), []).append(record)
    return found


def worst(records: list[Record], key: str) -> str:
    """Largest value over the median; "-" where there are not two values, or the median says nothing."""
    values = [record[key] for record in records if record.get(key) is not None]
    middle = statistics.median(values) if len(values) > 1 else 0.0
    return f"{max(values) / middle:.2f}" if middle > 1e-6 else "-"


def shares(records: list[Record]) -> str:
    """Median share of each part in the time of the whole process, in %; what no part claims is the rest."""
    by_part: dict[str, list[float]] = {}
    for record in records:
        claimed: dict[str, float] = {}
        for name, seconds in record["seconds"].items():
            part = "mapping" if name.startswith("pass_") else name
            claimed[part] = claimed.get(part, 0.0) + seconds
        claimed["rest"] = record["wall_s"] - sum(claimed.values())
        for part, seconds in claimed.items():
            by_part.setdefault(part, []).append(100 * seconds / record["wall_s"])
    return ", ".join(f"{part} {statistics.median(values):.0f}" for part, values in by_part.items())


def markdown(records: Iterable[Record]) -> str:
    """One row for each system and set of sensors. Columns without a value are out."""
    found, rows = groups(records), []
    for group, members in found.items():
        rivals = next((found[g] for g in found if g[:4] == (*group[:3], BASELINE)), [])
        rows.append([
            *group, str(len(members)), *(cell(members, *column[1:]) for column in COLUMNS),
            worst(members, "ate_m"), worst(members, "ate_aligned_m"), shares(members),
            ratio(members, rivals, "frames_per_s"), ratio(members, rivals, "loop_frames_per_s"),
        ])  # fmt: skip
    header = ["data set", "frames", "sensors", "system", "voxel cm", "runs", *(column[0] for column in COLUMNS)]
    header += ["worst / median", "worst / median, aligned", "parts %", "speed / open3d", "loop speed / open3d"]
    return "\n".join(markdown_table(header, rows))


def parse(arguments: list[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--sensors", nargs="+", default=[""], help="sets of sensors, like: sl sgm sl+psmnet")
    parser.add_argument("--systems", nargs="+", default=list(SYSTEMS), choices=SYSTEMS)
    parser.add_argument("--seeds", type=int, default=1, help=f"seeds of ours, from 0; others {REPETITIONS} at most [1]")
    parser.add_argument("--frames", default="", metavar="START:STOP", help="part of the sequence; all if not given")
    parser.add_argument("--open3d-voxel", nargs="+", type=float, default=[0.01], metavar="METRES", help="[0.01]")
    parser.add_argument("--mesh", action="store_true", help="score the meshes, too")
    parser.add_argument("--sfm-poses", type=Path, metavar="FILE", help="7-Scenes: poses of the colour images")
    parser.add_argument("--out", type=Path, default=Path("bench-out"), help="results and run directories [bench-out]")
    return parser.parse_args(arguments)


def main() -> int:
    options = parse()
    name = options.dataset.resolve().name
    place = options.out / (f"{name}_{options.frames.replace(':', '-')}" if options.frames else name)
    base, part = place / "base", ["--frames", options.frames] if options.frames else []
    uncle("preprocess", options.dataset, "--run", base, *part)  # keeps frames that are up to date
    if options.mesh and json.loads((base / "manifest.json").read_text())["reference_mesh"] is None:
        raise RunError(f"{options.dataset} has no true mesh; leave --mesh out")
    jobs = plan(name, options.frames, options.sensors, options.systems, options.open3d_voxel, options.seeds)
    once = partial(execute, base=base, run=place / "work", with_mesh=options.mesh, sfm_poses=options.sfm_poses)
    is_done = partial(_is_done, with_mesh=options.mesh, with_sfm=options.sfm_poses is not None)
    records, failed = carry_out(jobs, options.out / "tracking_results.json", once, is_done)
    print(markdown(r for r in records.values() if (r["dataset"], r["frames"]) == (name, options.frames)))
    for key, reason in failed.items():
        print(f"\nfailed: {key}: {reason}")
    return 1 if failed else 0


def _is_done(_: Job, record: Record, with_mesh: bool, with_sfm: bool) -> bool:
    return (record["with_mesh"] or not with_mesh) and ("ate_sfm_m" in record or not with_sfm or not record["posed"])


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
