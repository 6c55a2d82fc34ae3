"""Map with a method of your own: at each pixel only the nearest measurement of all sensors is fused.

    python examples/04_own_method.py RUN --voxel 0.03

`examples/plugin` has a method that `uncle map` finds by itself.
"""

import argparse
from pathlib import Path

import numpy as np
import torch
from uncle.recon.core.config.map_config import MapConfig
from uncle.recon.core.events import OnEvent, track_progress
from uncle.recon.methods import MethodSpec, register_method
from uncle.recon.run import RunDirectory, RunFrames
from uncle.recon.stages import map_run, mesh_run
from uncle.recon.volume import NeuralField, SparseGrid, TsdfVolume


def nearest_depth(depths: dict[str, torch.Tensor]) -> torch.Tensor:
    """(H, W) metres: the smallest measurement of the sensors at each pixel, 0 where none has any."""
    stack = torch.stack(list(depths.values()))
    nearest = torch.where(stack > 0, stack, torch.inf).amin(0)
    return torch.where(nearest.isfinite(), nearest, 0.0)


def fuse(
    frames: RunFrames, indices: list[int], config: MapConfig, on_event: OnEvent, poses: dict[int, np.ndarray] | None
) -> tuple[NeuralField, dict[int, np.ndarray]]:
    """A method of the kind "batch": the map, and T_world_camera of each frame in it.

    `poses` are tracked poses by frame index (`tracking.enabled`); None: take those of the recording.
    """
    voxel_m, fusion = config.fusion.voxel_size_m, config.fusion
    volume = TsdfVolume(SparseGrid(voxel_m), frames.camera, fusion.truncation_voxels * voxel_m, fusion.max_depth_m)
    used: dict[int, np.ndarray] = {}
    for frame in track_progress((frames[index] for index in indices), len(indices), "fusing", on_event):
        pose = frame.T_world_camera if poses is None else poses.get(frame.index)
        if pose is not None:
            depth, T_world_camera = nearest_depth(frame.depths), torch.from_numpy(pose).float()
            volume.allocate(depth, T_world_camera)
            volume.integrate(depth, None, frame.color, T_world_camera)
            used[frame.index] = pose
    return NeuralField.from_fusion(volume, fusion.min_observations, config.field, torch.Generator()), used


NEAREST = MethodSpec(
    name="nearest",
    summary="the nearest measurement of all sensors",
    kind="batch",
    implementation=fuse,
    preset={"fusion": {"passes": 0}, "uncertainty": {"enabled": False}, "field": {"iterations": 0, "levels": []}},
)


def main() -> None:
    """Register the method, map a run with it and extract the mesh."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--voxel", type=float, default=0.02, help="metres")
    options = parser.parse_args()

    register_method(NEAREST)
    config = NEAREST.configure([f"fusion.voxel_size_m={options.voxel}"])
    run = RunDirectory(options.run)
    summary = map_run(run, config, overwrite=True)
    mesh = mesh_run(run, overwrite=True)
    print(f"{summary.frames} frames, {mesh.vertices} vertices in {mesh.path}")


if __name__ == "__main__":
    main()
