"""Open3D's dense SLAM (frame to model) on the preprocessed frames of a run; see benchmarks/README.md.

Writes RUN/trajectory.txt (TUM text), RUN/open3d.json and, if asked, RUN/mesh.ply. It starts at the first given pose.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import open3d as o3d
from uncle.recon.core.errors import UncleError
from uncle.recon.core.files import DEPTH_UNITS_PER_M, encode_metres
from uncle.recon.core.frame import Frame
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames
from uncle.recon.stages.map import choose_sensors, peak_memory_mb

METHODS = {
    "open3d": o3d.t.pipelines.odometry.Method.PointToPlane,  # depth alone: Open3D's default
    "open3d-hybrid": o3d.t.pipelines.odometry.Method.Hybrid,  # depth and colour
}
DEPTH_MIN_M, DEPTH_MAX_M = 0.1, 6.0
DEPTH_DIFFERENCE_M = 0.07  # Open3D's default: pairs farther apart are left out
TRUNCATION_M = 0.08  # 8 voxels of 1 cm, Open3D's default; as wide with any other voxel size
RESOLUTION, START_BLOCKS = 16, 3000  # voxels along a block; the table of blocks grows as needed
MIN_FITNESS, MAX_STEP_M = 0.1, 0.15  # beyond them Open3D's own programs call a frame lost
MIN_MESH_WEIGHT = 3.0
DEVICE = o3d.core.Device("CPU:0")


@dataclass
class Outcome:
    """T_world_camera of every frame, those that were lost (they keep the pose before), and seconds by part."""

    model: o3d.t.pipelines.slam.Model
    poses: list[np.ndarray] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)

    def spend(self, part: str, since: float) -> float:
        now = time.perf_counter()
        self.seconds[part] = self.seconds.get(part, 0.0) + now - since
        return now


def slam(frames: RunFrames, method: str, voxel_m: float) -> Outcome:
    """Track each frame against the model and fuse it; a lost frame keeps the last pose and is not fused."""
    camera, truncation = frames.camera, TRUNCATION_M / voxel_m
    # One camera for everything, as in Open3D's own programs, although its fusion cuts pixel coordinates down to
    # integers and its odometry does not: benchmarks/README.md has what half a pixel more for the fusion changes.
    intrinsic = o3d.core.Tensor(camera.matrix)
    seen, expected = (o3d.t.pipelines.slam.Frame(camera.height, camera.width, intrinsic, DEVICE) for _ in range(2))
    first = frames.pose(0)
    T_world_camera = np.eye(4) if first is None else first
    start = o3d.core.Tensor(T_world_camera)
    out = Outcome(o3d.t.pipelines.slam.Model(voxel_m, RESOLUTION, START_BLOCKS, start, DEVICE))
    mapped, clock = 0, time.perf_counter()
    for index, (depth, color) in enumerate(frames.stream(range(len(frames)), images_of)):
        clock = out.spend("reading", clock)
        seen.set_data_from_image("depth", depth)
        seen.set_data_from_image("color", color)
        found = track(out.model, seen, expected, method) if mapped else np.eye(4)
        clock = out.spend("tracking", clock)
        if found is not None:
            T_world_camera = T_world_camera @ found
        # Counted in fused frames: Open3D shows no part of the model that was seen less often than min(count, 3).
        out.model.update_frame_pose(mapped, o3d.core.Tensor(T_world_camera))
        out.poses.append(T_world_camera)
        fused = found is not None and _run_uncle(out.model, seen, truncation)
        clock = out.spend("mapping", clock)
        mapped += fused
        if not fused:
            out.lost.append(index)
        if mapped:
            with_color = method == "open3d-hybrid"
            out.model.synthesize_model_frame(
                expected, DEPTH_UNITS_PER_M, DEPTH_MIN_M, DEPTH_MAX_M, truncation, with_color
            )
        clock = out.spend("ray casting", clock)
    return out


def track(model, seen, expected, method: str) -> np.ndarray | None:
    """(4, 4) motion since the last pose; None if Open3D finds none or would itself not believe it."""
    try:
        found = model.track_frame_to_model(
            seen, expected, DEPTH_UNITS_PER_M, DEPTH_MAX_M, DEPTH_DIFFERENCE_M, METHODS[method]
        )
    except RuntimeError:  # a singular system: too few pairs, or all on one plane
        return None
    motion = found.transformation.numpy()
    sound = np.isfinite(motion).all() and np.linalg.norm(motion[:3, 3]) < MAX_STEP_M
    return motion if sound and found.fitness >= MIN_FITNESS else None


def _run_uncle(model, seen, truncation: float) -> bool:
    """Fuse the frame; False if Open3D refuses, as it does where no depth is within reach."""
    try:
        model.integrate(seen, DEPTH_UNITS_PER_M, DEPTH_MAX_M, truncation)
    except RuntimeError:
        return False
    return True


def images_of(frame: Frame) -> tuple[o3d.t.geometry.Image, o3d.t.geometry.Image]:
    """Depth (mm, 16 bit) and colour. Several sensors: the mean of the readings that there are in a pixel."""
    depths = np.stack([depth.numpy() for depth in frame.depths.values()])
    mean = depths.sum(axis=0) / np.maximum((depths > 0).sum(axis=0), 1)
    return tuple(
        o3d.t.geometry.Image(o3d.core.Tensor(image))
        for image in (encode_metres(mean, DEPTH_UNITS_PER_M), frame.color.numpy())
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--sensors", nargs="+", default=[], help="all but the ground truth if not given")
    parser.add_argument("--method", choices=list(METHODS), default="open3d")
    parser.add_argument("--voxel", type=float, default=0.01, metavar="METRES")
    parser.add_argument("--mesh", action="store_true", help="write RUN/mesh.ply, too")
    options = parser.parse_args()
    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    run = RunDirectory(options.run)
    frames = RunFrames(run, choose_sensors(run.load_manifest(), tuple(options.sensors)))
    out = slam(frames, options.method, options.voxel)
    stamps = np.array([record.timestamp for record in frames.records])
    Trajectory(stamps, np.stack(out.poses)).save(run.trajectory_path)
    facts = {"frames": len(frames), "lost": out.lost, "seconds": out.seconds, "peak_memory_mb": peak_memory_mb()}
    facts["mesh_seconds"] = 0.0
    if options.mesh:
        began = time.perf_counter()
        mesh = out.model.voxel_grid.extract_triangle_mesh(MIN_MESH_WEIGHT).to_legacy()
        if len(mesh.triangles):
            o3d.io.write_triangle_mesh(str(run.mesh_path), mesh)
        facts["mesh_seconds"] = time.perf_counter() - began
    (options.run / "open3d.json").write_text(json.dumps(facts) + "\n")


if __name__ == "__main__":
    try:
        main()
    except (UncleError, OSError) as error:
        sys.exit(f"error: {error}")
