"""Fusion against exact distances, a slow reference that takes one voxel after another, and Open3D."""

from collections.abc import Callable

import numpy as np
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.map_config import make_config
from uncle.recon.methods.open3d_tsdf import fuse_open3d
from uncle.recon.methods.uncle.mapper import Mapper
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames
from uncle.recon.volume.sparse_grid import ROWS, SparseGrid
from uncle.recon.volume.tsdf_volume import ERROR_CORRELATION, MAX_SIGMA_M, MIN_SIGMA_M, FreeSpace, TsdfVolume

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)
VOXEL, TRUNCATION = 0.05, 0.2


def make_volume(camera: Camera = CAMERA, max_depth_m: float = 5.0) -> TsdfVolume:
    return TsdfVolume(SparseGrid(VOXEL), camera, TRUNCATION, max_depth_m)


def positions(volume: TsdfVolume) -> torch.Tensor:
    return volume.grid.block_positions(torch.arange(len(volume.grid.blocks))).view(-1, 3)


def plane(depth_m: float) -> torch.Tensor:
    return torch.full((60, 80), depth_m)


def fused(*readings: tuple[float, float | None]) -> TsdfVolume:
    """Planes at the given depths with the given weights, seen from the origin."""
    volume = make_volume()
    for depth, _ in readings:
        volume.allocate(plane(depth), torch.eye(4))
    for depth, weight in readings:
        volume.integrate(plane(depth), None if weight is None else plane(weight), None, torch.eye(4))
    return volume


def test_frontal_plane_has_exact_distances():
    volume = fused((2.0, None))
    z = positions(volume)[:, 2]
    seen = volume.counts() > 0
    assert seen.sum() > 5000
    torch.testing.assert_close(volume.sdf()[seen], (2.0 - z[seen]).clamp(max=TRUNCATION), atol=1e-6, rtol=0)
    assert not seen[z > 2.0 + TRUNCATION + 1e-4].any()  # nothing behind the truncation
    u, v, _ = CAMERA.project(positions(volume))
    in_view = (u > 0) & (u < 79) & (v > 0) & (v < 59) & (z < 2.0 + TRUNCATION - 1e-4)
    assert seen[in_view].all()
    assert (volume.sdf()[~seen] == 0).all()


def test_a_reading_speaks_for_the_free_space_before_it():
    """A near wall mapped first, then found to be absent by a farther one: its blocks turn free."""
    volume = fused((1.5, None), (3.0, None), (3.0, None))
    z = positions(volume)[:, 2]
    near = ((z - 1.5).abs() < 0.05) & (volume.counts() == 3)
    assert near.any()
    expected = ((1.5 - z[near]) + 2 * TRUNCATION) / 3
    torch.testing.assert_close(volume.sdf()[near], expected, atol=1e-6, rtol=0)


def test_weighted_mean_spread_count_and_sigma():
    volume = fused((2.0, 3.0), (2.1, 1.0))
    z = positions(volume)[:, 2]
    both = (volume.counts() == 2) & ((z - 2.05).abs() < 0.04)
    assert both.any()
    torch.testing.assert_close(volume.sdf()[both], 2.025 - z[both], atol=1e-5, rtol=0)
    spread = 0.1 * (0.75 * 0.25) ** 0.5
    torch.testing.assert_close(volume.samples().spread[both], torch.full_like(z[both], spread), atol=1e-4, rtol=0)
    sigma = spread * (ERROR_CORRELATION + (1 - ERROR_CORRELATION) / 2) ** 0.5
    torch.testing.assert_close(volume.samples().sigma[both], torch.full_like(z[both], sigma), atol=1e-4, rtol=0)
    assert volume.samples().sigma.min() >= MIN_SIGMA_M * 0.999


def test_stated_sigma_is_that_of_independent_readings_and_what_they_share():
    volume = fused((2.0, 3.0), (2.1, 1.0))
    z = positions(volume)[:, 2]
    both = (volume.counts() == 2) & ((z - 2.05).abs() < 0.04)
    sigma = (2 * 0.02**2 / 4.0 + ERROR_CORRELATION * 0.1**2 * 0.75 * 0.25) ** 0.5
    found = volume.samples().propagated_sigma(0.02)
    torch.testing.assert_close(found[both], torch.full_like(z[both], sigma), atol=1e-4, rtol=0)
    assert (found[volume.counts() == 0] == MAX_SIGMA_M).all()
    assert (volume.counts() == 0).any()


def test_readings_that_agree_leave_what_they_are_said_to_err():
    """A sensor that repeats its error has no spread; 8 readings of beta 4 cm are still only good to 2 cm."""
    volume = fused(*[(2.0, (0.01 / 0.04) ** 2)] * 8)
    near = (volume.counts() == 8) & ((positions(volume)[:, 2] - 2.0).abs() < 0.04)
    assert near.any()
    expected = torch.full((int(near.sum()),), 0.02)
    torch.testing.assert_close(volume.samples().propagated_sigma(0.01)[near], expected, atol=1e-4, rtol=0)
    assert (volume.samples().sigma[near] < 0.002).all()


def test_free_space_weight_is_the_geometric_mean():
    weight = torch.tensor([[1.0, 4.0], [0.04, 0.0]])
    found = FreeSpace.from_weight(weight, 0.25, plane(0.1))
    torch.testing.assert_close(found.weight, torch.tensor([[0.5, 1.0], [0.1, 0.0]]))


def test_doubt_weakens_only_the_claim_on_free_space():
    """Most of the image weighs 1, which is typical; the rest 4. In the band weights stay, before it they are drawn."""
    weight, doubt = plane(4.0), plane(0.3)
    weight[:40] = 1.0
    volume, plain = make_volume(), make_volume()
    for made in (volume, plain):
        made.allocate(plane(1.2), torch.eye(4))
        made.allocate(plane(2.0), torch.eye(4))
    volume.integrate(plane(2.0), weight, None, torch.eye(4), FreeSpace.from_weight(weight, 1.0, doubt))
    plain.integrate(plane(2.0), weight, None, torch.eye(4))
    found, full = volume.sums[:, 0], plain.sums[:, 0]
    beyond = 2.0 - positions(volume)[:, 2] - TRUNCATION
    seen = volume.counts() > 0
    assert torch.equal(seen, plain.counts() > 0)
    band, free = seen & (beyond < -1e-4), seen & (beyond > 1e-4)
    assert set(full[free].tolist()) == set(full[band].tolist()) == {1.0, 4.0}
    torch.testing.assert_close(found[band], full[band])
    expected = full[free].sqrt() * (1 - torch.exp(-beyond[free] / 0.3))
    torch.testing.assert_close(found[free], expected, rtol=1e-4, atol=1e-6)
    torch.testing.assert_close(volume.sdf()[free & (beyond > 0.1)], torch.tensor(TRUNCATION).expand(
        int((free & (beyond > 0.1)).sum())))  # fmt: skip


def test_doubt_without_weights_or_without_readings_changes_nothing():
    volume, plain = make_volume(), make_volume()
    for made in (volume, plain):
        made.allocate(plane(1.2), torch.eye(4))
    volume.integrate(plane(2.0), None, None, torch.eye(4), FreeSpace(plane(1.0), plane(0.3)))
    plain.integrate(plane(2.0), None, None, torch.eye(4))
    assert (plain.counts() > 0).any()
    assert torch.equal(volume.sums, plain.sums)
    volume.integrate(plane(0.0), plane(1.0), None, torch.eye(4), FreeSpace(plane(1.0), plane(0.3)))
    assert torch.equal(volume.sums, plain.sums)


def test_readings_out_of_reach_and_holes_take_no_part():
    volume = make_volume(max_depth_m=1.9)
    volume.allocate(plane(1.5), torch.eye(4))
    volume.integrate(plane(2.0), None, None, torch.eye(4))
    volume.integrate(plane(0.0), None, None, torch.eye(4))
    assert (volume.counts() == 0).all()
    blocks = len(volume.grid.blocks)
    volume.allocate(plane(2.0), torch.eye(4))
    volume.allocate(plane(0.0), torch.eye(4))
    assert len(volume.grid.blocks) == blocks


def test_colour_is_the_weighted_mean_near_the_surface():
    volume = make_volume()
    volume.allocate(plane(2.0), torch.eye(4))
    for weight, rgb in ((1.0, (255, 0, 51)), (3.0, (0, 255, 51))):
        color = torch.tensor(rgb, dtype=torch.uint8).expand(60, 80, 3)
        volume.integrate(plane(2.0), plane(weight), color, torch.eye(4))
    z = positions(volume)[:, 2]
    seen = volume.counts() > 0
    near = seen & ((z - 2.0).abs() < 0.4 * TRUNCATION)
    torch.testing.assert_close(
        volume.samples().colors[near], torch.tensor([0.25, 0.75, 0.2]).expand(int(near.sum()), 3)
    )
    assert (volume.samples().colors[~seen] == 0.5).all()


def test_growth_and_reset_keep_sums_in_their_rows():
    volume = fused((2.0, None))
    before, rows = volume.sums.clone(), volume.grid.rows
    for depth in (1.0, 1.4, 3.0, 4.0):  # several copies into larger tables
        volume.allocate(plane(depth), torch.eye(4))
        assert len(volume.sums) == len(volume.color_sums) == volume.grid.rows
    assert volume.grid.rows > 2 * rows
    torch.testing.assert_close(volume.sums[:rows], before)
    assert (volume.sums[rows:] == 0).all()
    volume.reset()
    assert (volume.sums == 0).all()
    volume.allocate(plane(4.9), torch.eye(4))
    assert (volume.sums == 0).all()


def test_every_reading_gets_blocks(box_room):
    volume = TsdfVolume(SparseGrid(0.02), box_room.camera, 0.08, 6.0)
    pose = box_room.pose(0.4)
    depth = box_room.depth(pose)
    volume.allocate(torch.from_numpy(depth).float(), torch.from_numpy(pose).float())
    points = box_room.camera.rays().numpy() * depth[..., None] @ pose[:3, :3].T + pose[:3, 3]
    blocks = torch.floor(torch.from_numpy(points).float() / volume.grid.block_size_m).long()
    assert (volume.grid.block_ids(blocks) >= 0).float().mean() > 0.995


def test_agrees_with_a_slow_reference(box_room):
    volume = make_volume(box_room.camera)
    poses = [box_room.pose(angle, (2.013, 1.507, 1.217)) for angle in (0.1, 0.4, 2.0)]  # no sample between two pixels
    depths = [box_room.depth(pose) + 0.01 * index for index, pose in enumerate(poses)]
    for depth, pose in zip(depths, poses, strict=True):
        volume.allocate(torch.from_numpy(depth).float(), torch.from_numpy(pose).float())
    weights = [np.full_like(depth, 1.0 + index) for index, depth in enumerate(depths)]
    for depth, weight, pose in zip(depths, weights, poses, strict=True):
        tensors = (torch.from_numpy(depth).float(), torch.from_numpy(weight).float())
        volume.integrate(*tensors, None, torch.from_numpy(pose).float())
    chosen = torch.randint(len(volume.grid.blocks) * ROWS, (4000,), generator=torch.Generator().manual_seed(0)).numpy()
    points = positions(volume).double().numpy()
    expected = np.zeros((len(chosen), 4))
    for sums, point in zip(expected, points[chosen], strict=True):
        for depth, weight, pose in zip(depths, weights, poses, strict=True):
            sums += _reading(box_room.camera, depth, weight, pose, point)
    found = volume.sums[torch.from_numpy(chosen)].numpy()
    agree = np.isclose(found, expected, atol=1e-4).all(1)
    assert (expected[:, 3] > 0).sum() > 1000
    assert agree.mean() > 0.999  # float32 may round a sample to the next pixel


def _reading(camera: Camera, depth: np.ndarray, weight: np.ndarray, pose: np.ndarray, point: np.ndarray) -> np.ndarray:
    """What one image adds to the sums of one sample."""
    x, y, z = pose[:3, :3].T @ (point - pose[:3, 3])
    if z <= 0.05:
        return np.zeros(4)
    column, row = round(camera.fx * x / z + camera.cx), round(camera.fy * y / z + camera.cy)
    if not (0 <= column < camera.width and 0 <= row < camera.height):
        return np.zeros(4)
    sdf = depth[row, column] - z
    if sdf <= -TRUNCATION:
        return np.zeros(4)
    sdf, w = min(sdf, TRUNCATION), weight[row, column]
    return np.array([w, w * sdf, w * sdf**2, 1.0])


def test_agrees_with_open3d(make_mappable_run: Callable[..., RunDirectory]):
    """Unit weights are plain fusion: the same distances as Open3D near the surface."""
    run = make_mappable_run(("gt",))
    frames = RunFrames(run)
    config = make_config("tsdf", ["fusion.voxel_size_m=0.04"], sensors=("gt",), device="cpu")
    baseline, poses = fuse_open3d(frames, list(range(len(frames))), config)
    mapper = Mapper(frames.camera, ("gt",), config, {}, torch.device("cpu"))
    for index, pose in poses.items():
        depth = frames.depth(index, "gt")
        mapper.volume.allocate(depth, torch.tensor(pose).float())
        mapper.volume.integrate(depth, None, frames.color(index), torch.tensor(pose).float())
    grid = mapper.volume.grid
    samples = torch.round(positions_of(grid) / grid.voxel_size_m).long()
    theirs = baseline.grid.sample_rows(samples)
    shared = (theirs >= 0) & mapper.observed_mask() & baseline.known[theirs.clamp(min=0)]
    ours = mapper.volume.sdf()[shared]
    other = baseline.base[theirs[shared], 0]
    near = (ours.abs() < 0.06) & (other.abs() < 0.06)
    assert near.sum() > 10000
    difference = (ours - other)[near].abs()
    assert difference.median() < 5e-4
    assert difference.quantile(0.99) < 5e-3


def positions_of(grid: SparseGrid) -> torch.Tensor:
    return grid.block_positions(torch.arange(len(grid.blocks))).view(-1, 3)


def integrated(volume: TsdfVolume, room, index: int, subtract_of_blocks: int | None = None) -> None:
    """Add, or subtract, the image of the room along angle 0.3 `index`, with weights and colours of its own."""
    pose = room.pose(0.3 * index)
    depth, generator = torch.from_numpy(room.depth(pose)).float(), torch.Generator().manual_seed(index)
    weight = 0.5 + torch.rand(depth.shape, generator=generator)
    color = torch.randint(0, 255, (*depth.shape, 3), generator=generator, dtype=torch.uint8)
    pose, free_space = torch.from_numpy(pose).float(), FreeSpace.from_weight(weight, 1.0, 0.1 * weight)
    if subtract_of_blocks is not None:
        volume.deintegrate(depth, weight, color, pose, free_space, subtract_of_blocks)
        return
    volume.allocate(depth, pose)
    volume.integrate(depth, weight, color, pose, free_space)


def test_what_is_taken_out_was_never_there(box_room):
    volume = make_volume(box_room.camera)
    integrated(volume, box_room, 0)
    sums, color_sums = volume.sums.clone(), volume.color_sums.clone()
    integrated(volume, box_room, 1)
    assert (volume.sums[: len(sums)] - sums).abs().max() > 0.5
    integrated(volume, box_room, 1, len(volume.grid.blocks))
    torch.testing.assert_close(volume.sums[: len(sums)], sums, atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(volume.color_sums[: len(sums)], color_sums, atol=1e-3, rtol=1e-6)
    assert volume.sums[len(sums) :].abs().max() < 1e-6
    volume.clear_empty()
    assert (volume.sums[len(sums) :] == 0).all()
    assert (volume.color_sums[volume.sums[:, 3] == 0] == 0).all()
    assert torch.equal(volume.counts()[: len(sums)], sums[:, 3])


def test_blocks_allocated_since_lose_nothing_to_what_is_taken_out(box_room):
    volume, without = make_volume(box_room.camera), make_volume(box_room.camera)
    integrated(volume, box_room, 0)
    blocks = len(volume.grid.blocks)
    without.grid.allocate(volume.grid.blocks)
    without.reset()
    for made in (volume, without):
        integrated(made, box_room, 1)
    assert len(volume.grid.blocks) > blocks
    integrated(volume, box_room, 0, blocks)
    volume.clear_empty()
    assert torch.equal(volume.grid.blocks, without.grid.blocks)
    torch.testing.assert_close(volume.sums, without.sums, atol=1e-6, rtol=1e-6)
    torch.testing.assert_close(volume.color_sums, without.color_sums, atol=1e-3, rtol=1e-6)
