"""The method `tsdf`: Open3D's own fusion with equal weights, the baseline for all others."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch

from ..core.camera import Camera
from ..core.config.map_config import MapConfig
from ..core.events import OnEvent, Progress, ignore
from ..run.frames import RunFrames
from ..volume.neural_field import NeuralField
from ..volume.sparse_grid import BLOCK, ROWS, SparseGrid

if TYPE_CHECKING:
    import open3d as o3d

_RESOLUTION = 16  # samples along the side of an Open3D block
_START_BLOCKS = 3000  # grows as needed; each takes 80 kB


def fuse_open3d(
    frames: RunFrames,
    indices: list[int],
    config: MapConfig,
    on_event: OnEvent = ignore,
    tracked: dict[int, np.ndarray] | None = None,
) -> tuple[NeuralField, dict[int, np.ndarray]]:
    """Fuse all sensors of `indices` with `VoxelBlockGrid.integrate`; returns map and T_world_camera by frame index.

    The poses are those `tracked`, by frame index, else those of the recording.
    """
    import open3d as o3d

    device, float32 = o3d.core.Device("CPU:0"), o3d.core.float32
    volume = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (float32, float32, float32), ((1), (1), (3)),
        config.fusion.voxel_size_m, _RESOLUTION, _START_BLOCKS, device,
    )  # fmt: skip
    intrinsic = o3d.core.Tensor(_corner_matrix(frames.camera))
    reach, truncation = config.fusion.max_depth_m, config.fusion.truncation_voxels
    poses = {}
    for done, frame in enumerate(frames.stream(indices, lambda frame: frame)):
        on_event(Progress("fusing", done, len(indices)))
        T_world_camera = frame.T_world_camera if tracked is None else tracked.get(frame.index)
        if T_world_camera is None:
            continue
        poses[frame.index] = T_world_camera
        extrinsic = o3d.core.Tensor(np.linalg.inv(T_world_camera))
        color = o3d.t.geometry.Image(frame.color.numpy().astype(np.float32) / 255)
        for metres in frame.depths.values():
            depth = o3d.t.geometry.Image(np.ascontiguousarray(metres.numpy()))
            if not bool(((metres > 0) & (metres < reach)).any()):
                continue
            blocks = volume.compute_unique_block_coordinates(depth, intrinsic, extrinsic, 1.0, reach, truncation)
            volume.integrate(blocks, depth, color, intrinsic, intrinsic, extrinsic, 1.0, reach, truncation)
    on_event(Progress("fusing", len(indices), len(indices)))
    return _to_field(volume, config), poses


def _corner_matrix(camera: Camera) -> np.ndarray:
    """Intrinsics for Open3D's fusion, which cuts pixel coordinates down to integers: pixel centres at +0.5."""
    matrix = camera.matrix
    matrix[:2, 2] += 0.5
    return matrix


def _to_field(volume: o3d.t.geometry.VoxelBlockGrid, config: MapConfig) -> NeuralField:
    """Open3D's blocks of 16^3 (x fastest, distances in truncations) as ours of 8^3 (z fastest, metres)."""
    table = volume.hashmap()
    active = table.active_buf_indices().numpy()
    keys = torch.from_numpy(table.key_tensor().numpy()[active]).long()

    def rows(name: str) -> torch.Tensor:
        values = torch.from_numpy(volume.attribute(name).numpy()[active])
        channels = values.shape[-1]
        cubes = values.view(-1, 2, BLOCK, 2, BLOCK, 2, BLOCK, channels)  # block, z, z, y, y, x, x
        return cubes.permute(0, 5, 3, 1, 6, 4, 2, 7).reshape(-1, channels)

    halves = torch.tensor([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    grid = SparseGrid(config.fusion.voxel_size_m)
    grid.restore((keys[:, None] * 2 + halves).view(-1, 3))
    truncation = config.fusion.truncation_voxels * config.fusion.voxel_size_m
    base = torch.cat([rows("tsdf") * truncation, rows("color")], 1)
    counts = rows("weight")[:, 0]
    assert len(base) == grid.rows == len(grid.blocks) * ROWS
    sigma = torch.full_like(counts, truncation)  # plain fusion says nothing about its own error
    plain = config.field.model_copy(update={"levels": ()})
    return NeuralField(grid, base, sigma, counts >= config.fusion.min_observations, plain, torch.Generator())
