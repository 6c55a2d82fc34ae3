"""Depth alone, in a room with balls whose every distance is known: steps far beyond the truncation band."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from uncle.recon.core.config.uncle import TrackingConfig
from uncle.recon.core.frame import Frame
from uncle.recon.core.normals import normals, smooth_depth
from uncle.recon.core.se3 import apply_motion, inverse, motion_between, rotation_angle
from uncle.recon.tracking.depth_only import align_to_tsdf, coarse_to_fine_icp, expectation, track_from_keyframe
from uncle.recon.tracking.frame_to_frame import SurfaceView
from uncle.recon.tracking.frame_to_model import Readings
from uncle.recon.tracking.graph_adjustment import adjust_globally
from uncle.recon.tracking.graph_optimisation import optimise_after_keyframe
from uncle.recon.tracking.keyframe_graph import KeyframeGraph
from uncle.recon.tracking.landmarks import FrameFeatures
from uncle.recon.tracking.tracker import AlignTracker
from uncle.recon.volume.sparse_grid import SparseGrid
from uncle.recon.volume.tsdf_volume import TsdfVolume

BALLS = (
    ((3.2, 2.2, 0.9), 0.45),
    ((2.7, 2.6, 1.8), 0.3),
    ((0.7, 0.6, 0.9), 0.4),
    ((3.3, 0.5, 1.5), 0.4),
    ((0.6, 2.4, 1.6), 0.35),
)  # centre and radius, metres
CORNER = 0.785
TRUNCATION_M = 0.08


def depth_of(room, pose: np.ndarray) -> np.ndarray:
    """(H, W) metres of the room with its balls."""
    depth = room.depth(pose)
    rays = room.camera.rays().numpy().astype(np.float64) @ pose[:3, :3].T
    for centre, radius in BALLS:
        to = pose[:3, 3] - centre
        a, b, c = (rays**2).sum(-1), rays @ to, to @ to - radius**2
        root = b**2 - a * c
        hit = (-b - np.sqrt(np.maximum(root, 0))) / a
        depth = np.where((root > 0) & (hit > 0.1), np.minimum(depth, hit), depth)
    return depth


def noisy(depth: np.ndarray, index: int, draw: int = 0) -> np.ndarray:
    error = np.random.default_rng(index + 1000 * draw).laplace(0.0, 0.001, depth.shape)
    return np.where(depth > 0, np.round(depth + error * depth**2, 3), 0.0)


def view_of(room, depth: np.ndarray, sigma_m: float = 0.01) -> SurfaceView:
    smoothed = smooth_depth(torch.from_numpy(depth).float().numpy())
    surface = np.asarray(normals(smoothed, room.camera), dtype=np.float64)
    valid = (depth > 0) & (np.abs(surface).sum(-1) > 0)
    points = room.camera.rays().numpy() * depth[..., None]
    return SurfaceView(room.camera, points, surface, np.where(valid, sigma_m, np.inf))


@dataclass(frozen=True)
class Followed:
    """What the tracker made of depth images, in order; poses (4, 4) by index."""

    tracker: AlignTracker
    poses: dict[int, np.ndarray]

    @property
    def statuses(self) -> list[str]:
        return [f.status for f in self.tracker.frames]

    def off_m(self, truth: Sequence[np.ndarray]) -> np.ndarray:
        return np.array([np.linalg.norm(pose[:3, 3] - truth[i][:3, 3]) for i, pose in self.poses.items()])


def follow(room, depths: Sequence[np.ndarray], first: np.ndarray, draw: int = 0) -> Followed:
    """Track by depth alone; keyframes and every third frame enter the map, as in `uncle map --track --no-color`."""
    volume = TsdfVolume(SparseGrid(0.02), room.camera, TRUNCATION_M, 6.0)
    tracker = AlignTracker(room.camera, TrackingConfig(color=False), 0, (None,), volume)
    for index, exact in enumerate(depths):
        depth = torch.from_numpy(noisy(exact, index, draw)).float()
        surface = torch.from_numpy(np.asarray(normals(smooth_depth(depth.numpy()), room.camera))).float()
        black = torch.zeros(*depth.shape, 3, dtype=torch.uint8)
        frame = Frame(index, float(index), black, {"depth": depth}, first if index == 0 else None)
        pose = tracker.track(frame, tracker.prepare(frame, {"depth": surface}), {})
        if pose is not None and (tracker.is_keyframe() or index % 3 == 0):
            T = torch.from_numpy(pose).float()
            volume.allocate(depth, T)
            volume.integrate(depth, None, black, T)
    return Followed(tracker, tracker.finish())


def typical_drift_m(room, poses: list[np.ndarray], draws: int = 9) -> float:
    """How far the camera gets off at most, the median of several draws of the noise: a single one differs by 1 cm, and
    already by how a processor rounds, so that the median of three does, too."""
    depths = [depth_of(room, pose) for pose in poses]
    results = [follow(room, depths, poses[0], draw) for draw in range(draws)]
    assert not any("lost" in result.statuses for result in results)
    assert all(len(result.tracker.graph.keyframes) > 3 for result in results)
    return float(np.median([result.off_m(poses).max() for result in results]))


def steps(room, step_m: float, count: int = 9) -> list[np.ndarray]:
    """Sideways from a standstill by `step_m` and 2 degrees a frame."""
    poses = [room.pose(CORNER, (1.4, 1.3, 1.2))]
    for _ in range(count):
        poses.append(apply_motion(poses[-1], np.array([step_m, 0.0, 0.0, 0.0, -0.035, 0.0])))
    return poses


@pytest.mark.parametrize("step_m", [0.05, 0.07, 0.10, 0.15])
def test_fast_motion_is_followed(box_room, step_m):
    assert typical_drift_m(box_room, steps(box_room, step_m)) < 0.03


def test_sudden_turning_back_is_followed(box_room):
    """Where the motion so far leads, the camera is not: 20 cm off."""
    ways = steps(box_room, 0.10, 4)
    assert typical_drift_m(box_room, [*ways, *ways[-2::-1], *ways[1:]]) < 0.02


def test_a_lost_camera_is_found_at_a_keyframe(box_room):
    """Three frames without depth, while the camera goes back to where it has been; the median of several draws."""
    way = steps(box_room, 0.10)
    poses = [*way, *way[6:3:-1], *way[2::-1]]
    depths = [depth_of(box_room, pose) * (not 10 <= i < 13) for i, pose in enumerate(poses)]
    results = [follow(box_room, depths, poses[0], draw) for draw in range(9)]
    for result in results:
        assert [i for i, s in enumerate(result.statuses) if s == "lost"] == [10, 11, 12]
        assert result.statuses[13] == "relocalised"
    assert np.median([result.off_m(poses).max() for result in results]) < 0.02


@pytest.mark.parametrize(
    ("shift_m", "most_m"), [((0.07, 0.0, 0.0), 0.01), ((0.0, 0.0, 0.05), 0.07)], ids=["along", "towards"]
)
def test_before_a_plain_wall_no_motion_along_it_is_invented(box_room, shift_m, most_m):
    """Noise makes the camera wander along the wall a little when it comes nearer, but not as on a way."""
    poses = [apply_motion(np.eye(4), np.array([*(i * np.array(shift_m)), 0.0, 0.0, 0.0])) for i in range(10)]
    depths = [np.full((120, 160), 1.8) - pose[2, 3] for pose in poses]
    result = follow(box_room, depths, poses[0])
    assert set(result.statuses[1:]) == {"weak"}
    found = np.stack([result.poses[i] for i in range(10)])
    assert np.abs(found[:, :2, 3]).max() < most_m
    assert np.abs(found[:, 2, 3] - [pose[2, 3] for pose in poses]).max() < 0.01
    sigma = np.sqrt(np.diagonal(np.array(result.tracker.record().frames[-1].covariance)))
    assert sigma[:2].min() > 5 * sigma[2]  # and it is said which directions are open


def test_what_does_not_fit_is_lost(box_room):
    poses = steps(box_room, 0.05, 3)
    depths = [depth_of(box_room, pose) for pose in poses]
    rng = np.random.default_rng(0)
    blocks = np.kron(rng.uniform(0.6, 3.0, (6, 8)), np.ones((20, 20)))
    result = follow(box_room, [*depths, blocks, blocks[::-1], np.full_like(blocks, 0.4)], poses[0])
    assert result.statuses[4:] == ["lost"] * 3


def test_a_view_draws_from_far(box_room):
    """20 cm and 6 degrees: the truncation band is 8 cm."""
    true = box_room.pose(CORNER)
    keyframe = (view_of(box_room, depth_of(box_room, true)), true)
    away = apply_motion(true, np.array([0.15, -0.08, 0.1, 0.05, 0.08, -0.03]))
    view = view_of(box_room, depth_of(box_room, away))
    found = coarse_to_fine_icp(keyframe, view, true, expectation(true, true))
    assert np.linalg.norm((inverse(away) @ found)[:3, 3]) < 0.01
    assert rotation_angle(inverse(away) @ found) < 0.01


@pytest.fixture(scope="module")
def mapped(box_room) -> tuple[TsdfVolume, Readings, np.ndarray, np.ndarray]:
    """A map of one view, readings of it, where it was taken from, its depth."""
    pose = box_room.pose(CORNER)
    depth = depth_of(box_room, pose)
    volume = TsdfVolume(SparseGrid(0.02), box_room.camera, TRUNCATION_M, 6.0)
    T, image = torch.from_numpy(pose).float(), torch.from_numpy(depth).float()
    volume.allocate(image, T)
    volume.integrate(image, None, torch.zeros(120, 160, 3, dtype=torch.uint8), T)
    read = torch.from_numpy(noisy(depth, 1)).float()[::4, ::4, None]
    rays = box_room.camera.rays()[::4, ::4]
    points = (rays * read).reshape(-1, 3)
    return volume, Readings(points, rays.reshape(-1, 3), torch.full((len(points),), 0.02), None), pose, depth


def test_the_yardstick_of_a_fit_does_not_depend_on_what_is_promised(mapped):
    """Learning makes the promises smaller, which is no reason to be lost."""
    volume, readings, pose, _ = mapped
    prior = expectation(pose, pose)
    modest = align_to_tsdf(volume, readings, pose, prior)
    bold = align_to_tsdf(volume, replace(readings, beta=readings.beta / 10), pose, prior)
    assert bold.scale > 3 * modest.scale
    assert bold.fit == pytest.approx(modest.fit, rel=0.1)
    assert modest.fit < 0.5


def test_being_sure_takes_more(mapped):
    """A quarter of the readings where the map is not known: enough for what was expected, not to be found again."""
    volume, readings, pose, _ = mapped
    stray = readings.points.clone()
    stray[::3] *= 0.5
    readings = replace(readings, points=stray)
    prior = expectation(pose, pose)
    assert align_to_tsdf(volume, readings, pose, prior) is not None
    assert align_to_tsdf(volume, readings, pose, prior, sure=True) is None


def test_a_standstill_is_tried_after_the_expected_motion(box_room, mapped):
    volume, readings, pose, depth = mapped
    keyframe = (view_of(box_room, depth), pose)
    away = apply_motion(pose, np.array([0.0, 0.0, -30.0, 0.0, 0.0, 0.0]))
    candidates = list(track_from_keyframe(volume, readings, keyframe[0], keyframe, pose, away))
    assert len(candidates) == 1
    assert np.abs(motion_between(pose, candidates[0].pose)).max() < 0.01


def test_the_longer_lost_the_less_is_expected():
    start, off = np.eye(4), apply_motion(np.eye(4), np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0]))
    costs = [expectation(start, start, lost)(off).cost for lost in (0, 2, 5, 10, 100)]
    assert costs[0] > costs[1] > costs[2] > costs[3] == costs[4]


def test_a_way_round_the_room_is_closed_without_features(box_room):
    """Drifting 4 mm and 0.2 degrees a keyframe; the surfaces of where it began bring it back."""
    graph, none = KeyframeGraph(box_room.camera, 0), np.zeros((0, 128), np.float32)
    truth = [box_room.pose(a) for a in np.linspace(0, 2 * np.pi, 25)]
    drift = np.array([0.004, 0.0, 0.002, 0.0, 0.0035, 0.0])
    pose = truth[0]
    for index, true in enumerate(truth):
        if index:
            pose = apply_motion(graph.frames[-1].pose @ inverse(truth[index - 1]) @ true, drift)
        empty = np.zeros((0, 1))
        frame_features = FrameFeatures(
            index, pose, np.zeros((0, 2)), np.zeros(0), empty, empty, empty, np.zeros((0, 1, 0), np.float32),
            np.zeros(0, np.int64),
        )  # fmt: skip
        graph.add(frame_features, none, view_of(box_room, depth_of(box_room, true)))
        optimise_after_keyframe(graph)
    adjust_globally(graph)
    assert any(first < 3 and later > 21 for first, later in graph.loops)
    off = [np.linalg.norm(s.pose[:3, 3] - true[:3, 3]) for s, true in zip(graph.frames, truth, strict=True)]
    assert max(off) < 0.02
    assert off[-1] < 0.005
