"""Use beta as a weight in Open3D: integrate depth with the weights 1 / beta^2 into a VoxelBlockGrid.

    python examples/02_beta_as_weight_in_open3d.py RUN --sensors sl sgm --out weighted.ply

`VoxelBlockGrid.integrate` weights all measurements equally. Here the tensors of the grid are updated directly: each
voxel keeps the mean distance, weighted by the inverse variance of the measurements.
"""

import argparse
from pathlib import Path

import numpy as np
import open3d as o3d
from uncle.recon.run import RunDirectory, RunFrames

REFERENCE_BETA_M = 0.01  # a measurement with this beta has the weight 1; only ratios of weights matter
MIN_WEIGHT = 0.1  # voxels with less are not part of the surface
MAX_DEPTH_M = 6.0
TRUNCATION_VOXELS = 4.0


class WeightedVolume:
    """A VoxelBlockGrid of truncated signed distances (in truncations) and weights."""

    def __init__(self, voxel_m: float) -> None:
        float32 = o3d.core.float32
        self.grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (float32, float32), ((1), (1)), voxel_m, 16, 5000, o3d.core.Device("CPU:0")
        )
        self.truncation_m = TRUNCATION_VOXELS * voxel_m

    def integrate(self, depth: np.ndarray, beta: np.ndarray, matrix: np.ndarray, T_world_camera: np.ndarray) -> None:
        """Add an image: depth and beta (H, W) metres, 0 = no measurement; matrix (3, 3) intrinsics; pose (4, 4)."""
        T_camera_world = np.linalg.inv(T_world_camera)
        blocks = self.grid.compute_unique_block_coordinates(
            o3d.t.geometry.Image(np.ascontiguousarray(depth)), o3d.core.Tensor(matrix),
            o3d.core.Tensor(T_camera_world), 1.0, MAX_DEPTH_M, TRUNCATION_VOXELS,
        )  # fmt: skip
        self.grid.hashmap().activate(blocks)
        buffers, _ = self.grid.hashmap().find(blocks)
        coordinates, indices = self.grid.voxel_coordinates_and_flattened_indices(buffers)
        points, voxels = coordinates.numpy().astype(np.float64), indices.numpy()

        # the pixel that each voxel projects to, and the measurement there
        x, y, z = (points @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]).T
        z = np.where(z > 0, z, np.inf)
        u = np.round(matrix[0, 0] * x / z + matrix[0, 2]).astype(int)
        v = np.round(matrix[1, 1] * y / z + matrix[1, 2]).astype(int)
        height, width = depth.shape
        inside = np.isfinite(z) & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        measured, scale = np.zeros_like(x), np.zeros_like(x)
        measured[inside], scale[inside] = depth[v[inside], u[inside]], beta[v[inside], u[inside]]
        sdf = (measured - z) / self.truncation_m
        usable = (measured > 0) & (measured < MAX_DEPTH_M) & (scale > 0) & (sdf > -1)
        self._average(voxels[usable], np.minimum(sdf[usable], 1), (REFERENCE_BETA_M / scale[usable]) ** 2)

    def _average(self, voxels: np.ndarray, sdf: np.ndarray, added: np.ndarray) -> None:
        """Update the running weighted mean of `voxels`; `added` are the weights of the distances `sdf`."""
        tsdf = self.grid.attribute("tsdf").reshape((-1,)).numpy()  # arrays that share the memory of the grid
        weight = self.grid.attribute("weight").reshape((-1,)).numpy()
        total = weight[voxels] + added
        tsdf[voxels] += (sdf - tsdf[voxels]) * added / total
        weight[voxels] = total

    def mesh(self) -> o3d.geometry.TriangleMesh:
        """The surface."""
        return self.grid.extract_triangle_mesh(MIN_WEIGHT).to_legacy()


def main() -> None:
    """Integrate all mapped frames of a run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("--sensors", nargs="+", required=True)
    parser.add_argument("--voxel", type=float, default=0.02, help="metres")
    parser.add_argument("--out", type=Path, default=Path("weighted.ply"))
    options = parser.parse_args()

    run = RunDirectory(options.run)
    frames = RunFrames(run, options.sensors)
    volume = WeightedVolume(options.voxel)
    for index in range(len(frames)):
        pose = frames.pose(index)
        for sensor in options.sensors:
            if pose is not None and run.beta_path(sensor, index).exists():
                depth, beta = frames.depth(index, sensor).numpy(), frames.beta(index, sensor).numpy()
                volume.integrate(depth, beta, frames.camera.matrix, pose)
    mesh = volume.mesh()
    o3d.io.write_triangle_mesh(str(options.out), mesh)
    print(f"{len(mesh.vertices)} vertices; wrote {options.out}")


if __name__ == "__main__":
    main()
