"""Frames against the fused surface of a room whose every distance is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from uncle.recon.core.se3 import apply_motion, inverse, motion_between, rotation_angle, transform
from uncle.recon.tracking.frame_to_model import (
    COLOR_SIGMA,
    LEAST_SCALE,
    Readings,
    agreement,
    scaled,
    surface_residuals,
    surface_term,
)
from uncle.recon.tracking.pose_estimation import minimise
from uncle.recon.volume.sparse_grid import SparseGrid
from uncle.recon.volume.tsdf_volume import TsdfVolume

CORNER = 0.785  # the angle at which the camera sees a corner of the room
OFF = np.array([0.02, -0.015, 0.025, 0.008, -0.01, 0.006])


def texture(points: np.ndarray) -> np.ndarray:
    """Grey (...) 0..1 of points in the room (..., 3): soft waves."""
    return 0.5 + 0.2 * np.sin(4 * points[..., 0] + 1) * np.cos(3 * points[..., 1]) + 0.15 * np.sin(5 * points[..., 2])


def view(room, pose, depth=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """depth (H, W), points in camera axes (H, W, 3) and grey (H, W)."""
    depth = room.depth(pose) if depth is None else depth
    points = room.camera.rays().numpy() * depth[..., None]
    return depth, points, texture(transform(pose, points))


def fused(room, poses, depths=None) -> TsdfVolume:
    volume = TsdfVolume(SparseGrid(0.03), room.camera, 0.15, 6.0)
    for index, pose in enumerate(poses):
        depth, _, grey = view(room, pose, None if depths is None else depths[index])
        color = torch.from_numpy(np.rint(255 * grey)).to(torch.uint8)[..., None].expand(-1, -1, 3)
        depth, T = torch.from_numpy(depth).float(), torch.from_numpy(pose).float()
        volume.allocate(depth, T)
        volume.integrate(depth, None, color, T)
    return volume


def readings(room, pose, color: bool, step: int = 6, depth=None) -> Readings:
    _, points, grey = view(room, pose, depth)
    points = torch.from_numpy(points[::step, ::step]).float().reshape(-1, 3)
    grey = torch.from_numpy(grey[::step, ::step]).float().reshape(-1) if color else None
    return Readings(points, points / points[:, 2:], torch.full((len(points),), 0.01), grey)


@pytest.fixture(scope="module")
def corner(box_room) -> TsdfVolume:
    return fused(box_room, [box_room.pose(CORNER + turn) for turn in (-0.15, 0.0, 0.15)])


@pytest.fixture(scope="module")
def wall() -> tuple[np.ndarray, np.ndarray]:
    """A pose that looks straight at a plane, and the depth there."""
    return np.eye(4), np.full((120, 160), 1.5)


@pytest.mark.parametrize("color", [False, True])
def test_jacobian_against_differences(box_room, corner, color):
    """With sigmas that do not change: the derivative is of the distance alone (as in any Gauss-Newton)."""
    pose = apply_motion(box_room.pose(CORNER), OFF)
    taken = readings(box_room, box_room.pose(CORNER), color)
    taken = replace(taken, beta=torch.full_like(taken.beta, 1e-6))
    corner_sums = corner.sums.clone()
    corner.sums[:, 2] = corner.sums[:, 1] ** 2 / corner.sums[:, 0].clamp(min=1)  # no spread: sigma is the least
    r, jacobian = surface_residuals(corner, taken, pose)
    assert len(r) > 300 * (1 + color)
    step = 2e-4
    for axis in range(6):
        ahead, behind = (
            surface_residuals(corner, taken, apply_motion(pose, s * step * np.eye(6)[axis]))[0] for s in (1, -1)
        )
        assert len(ahead) == len(behind) == len(r)
        change = ((ahead - behind) / (2 * step)).numpy()
        if color:  # the median of the colours, which is no part of the derivative, moves all by the same
            half = len(r) // 2
            change[half:] -= np.median(change[half:] - jacobian[half:, axis].numpy())
        size = np.abs(jacobian[:, axis].numpy()).max()
        close = np.abs(change - jacobian[:, axis].numpy()) < 0.02 * size
        assert close.mean() > 0.97  # the others leave their cell, where the derivative jumps
    corner.sums.copy_(corner_sums)


def test_residuals_at_the_truth_are_small_and_known(box_room, corner):
    pose = box_room.pose(CORNER)
    r, _ = surface_residuals(corner, readings(box_room, pose, True), pose)
    distances, colors = r.chunk(2)
    assert float(distances.abs().median()) < 0.2
    assert float(colors.abs().median()) * COLOR_SIGMA < 0.02


@pytest.mark.parametrize("color", [False, True])
def test_a_corner_brings_the_camera_back(box_room, corner, color):
    true = box_room.pose(CORNER)
    found, information = minimise(
        apply_motion(true, OFF), [surface_term(corner, readings(box_room, true, color, 4))], 30
    )
    off = inverse(true) @ found
    assert np.linalg.norm(off[:3, 3]) < 1e-3
    assert rotation_angle(off) < 1e-3
    assert np.linalg.eigvalsh(information).min() > 0


def test_along_a_plane_nothing_moves(box_room, wall):
    pose, depth = wall
    volume = fused(box_room, [pose] * 2, [depth] * 2)
    taken = readings(box_room, pose, False, depth=depth)
    start = apply_motion(pose, np.array([0.03, -0.02, 0.04, 0.0, 0.0, 0.02]))
    found, _ = minimise(start, [surface_term(volume, taken)], 20)
    motion = motion_between(pose, found)
    assert abs(motion[2]) < 1e-3  # what the plane tells
    np.testing.assert_allclose(motion[[0, 1, 5]], [0.03, -0.02, 0.02], atol=1e-3)


def test_colour_tells_the_motion_along_a_plane(box_room, wall):
    pose, depth = wall
    volume = fused(box_room, [pose] * 2, [depth] * 2)
    start = apply_motion(pose, np.array([0.03, -0.02, 0.02, 0.0, 0.0, 0.02]))
    found, _ = minimise(start, [surface_term(volume, readings(box_room, pose, True, 4, depth))], 30)
    assert np.abs(motion_between(pose, found)).max() < 4e-3


def test_leaving_the_map_does_not_pay(box_room, corner):
    true = box_room.pose(CORNER)
    term = surface_term(corner, readings(box_room, true, True))
    away = apply_motion(true, np.array([0.0, 0.0, -50.0, 0.0, 0.0, 0.0]))
    assert term(away).cost > term(apply_motion(true, 2 * OFF)).cost > term(true).cost
    assert (term(away).information == 0).all()
    assert (term(away).gradient == 0).all()


def test_agreement_and_scale(box_room, corner):
    true = box_room.pose(CORNER)
    taken = readings(box_room, true, False, 4)
    assert agreement(corner, taken, true)[0] > 0.95
    assert agreement(corner, taken, true)[1] > 0.95
    off = apply_motion(true, np.array([0.0, 0.0, 0.1, 0.0, 0.0, 0.0]))
    assert agreement(corner, taken, off)[1] < 0.5
    nothing = Readings(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0), None)
    assert agreement(corner, nothing, true) == (0.0, 0.0)
    r, _ = surface_residuals(corner, taken, true)
    expected = max(LEAST_SCALE, 1.48 * float(r.abs().median()))
    assert scaled(corner, taken, true).scale == pytest.approx(expected)
    assert scaled(corner, taken, off).scale == 1.0  # never larger
    assert scaled(corner, nothing, true) is nothing
