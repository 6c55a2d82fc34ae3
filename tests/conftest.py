"""A room whose every depth is known, on disk as a run."""

from __future__ import annotations

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # as the program itself; PyTorch reads it when it is loaded

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.files import BETA_UNITS_PER_M, DEPTH_UNITS_PER_M, encode_metres, write_image, write_text
from uncle.recon.core.frame import Frame
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import encode_normals
from uncle.recon.run.manifest import FrameRecord, Manifest

ROOM_M = np.array([4.0, 3.0, 2.5])
FACES = np.array([[0, 2, 3], [0, 3, 1], [4, 5, 7], [4, 7, 6], [0, 1, 5], [0, 5, 4], [2, 6, 7], [2, 7, 3], [0, 4, 6],
                  [0, 6, 2], [1, 3, 7], [1, 7, 5]], dtype=np.int32)  # fmt: skip


@dataclass(frozen=True)
class BoxRoom:
    """A room with one corner at the origin and the other at `ROOM_M`, z up, seen from a circle inside it."""

    camera: Camera = field(default_factory=lambda: Camera(160, 120, 90.0, 90.0, 79.5, 59.5))

    def mesh(self, grow_m: float = 0.0) -> Mesh:
        """The walls, each moved outwards by `grow_m`."""
        corners = np.array([[x, y, z] for z in (0, 1) for y in (0, 1) for x in (0, 1)], dtype=np.float64)
        return Mesh((corners * (ROOM_M + 2 * grow_m) - grow_m).astype(np.float32), FACES)

    def pose(self, angle: float, centre: tuple[float, float, float] = (2.0, 1.5, 1.2)) -> np.ndarray:
        """(4, 4) T_world_camera: level, looking along `angle` in the horizontal plane."""
        forward = np.array([np.cos(angle), np.sin(angle), 0.0])
        T = np.eye(4)
        T[:3, :3] = np.column_stack([np.cross([0.0, 0.0, -1.0], forward), [0.0, 0.0, -1.0], forward])
        T[:3, 3] = np.array(centre) - 0.4 * forward
        return T

    def depth(self, T_world_camera: np.ndarray, grow_m: float = 0.0) -> np.ndarray:
        """(H, W) float64 exact z-depth of the walls, by slabs."""
        directions = self.camera.rays().numpy().astype(np.float64) @ T_world_camera[:3, :3].T
        origin = T_world_camera[:3, 3]
        safe = np.where(np.abs(directions) < 1e-12, 1e-12, directions)
        far = np.where(safe > 0, ROOM_M + grow_m - origin, -grow_m - origin) / safe
        return far.min(axis=-1)

    def picture(self, T_world_camera: np.ndarray, blank_above_m: float = np.inf) -> np.ndarray:
        """(H, W, 3) uint8 walls painted with a smooth random pattern of waves in space; grey 128 above that height."""
        points = self.camera.rays().numpy() * self.depth(T_world_camera)[..., None]
        points = points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        rng = np.random.default_rng(0)
        waves = rng.normal(size=(40, 3))
        waves *= 2 * np.pi / (rng.uniform(0.15, 0.8, (40, 1)) * np.linalg.norm(waves, axis=1, keepdims=True))
        pattern = np.sin(points @ waves.T + rng.uniform(0, 2 * np.pi, 40)).sum(-1) * 10
        pattern[points[..., 2] > blank_above_m] = 0
        return np.clip(np.rint(128 + pattern[..., None] * np.array([1.0, 0.9, 0.8])), 0, 255).astype(np.uint8)

    def normals(self, T_world_camera: np.ndarray) -> np.ndarray:
        """(H, W, 3) float32 exact unit normals of the walls in camera axes, towards the camera."""
        points = self.camera.rays().numpy() * self.depth(T_world_camera)[..., None]
        points = points @ T_world_camera[:3, :3].T + T_world_camera[:3, 3]
        gaps = np.stack([points, ROOM_M - points], axis=-1).reshape(*points.shape[:2], 6)  # x low, x high, y low ...
        wall = np.abs(gaps).argmin(-1)
        inwards = np.eye(3)[wall // 2] * np.where(wall % 2 == 0, 1.0, -1.0)[..., None]
        return (inwards @ T_world_camera[:3, :3]).astype(np.float32)


@pytest.fixture(scope="session")
def box_room() -> BoxRoom:
    return BoxRoom()


@pytest.fixture
def make_box_run(tmp_path: Path, box_room: BoxRoom) -> Callable[..., RunDirectory]:
    """Makes a preprocessed run of the room, in one colour; the errors of sensor `noisy` are Laplace, of a scale that
    grows with depth."""

    def make(sensors: tuple[str, ...] = ("gt", "noisy"), angles: np.ndarray | None = None) -> RunDirectory:
        run = RunDirectory(tmp_path / "run")
        angles = np.linspace(0, 2 * np.pi, 12, endpoint=False) if angles is None else angles
        poses = [box_room.pose(angle) for angle in angles]
        records = []
        for index, pose in enumerate(poses):
            _write_depths(run, box_room, sensors, index, pose)
            record = FrameRecord(
                index=index, source_index=index, timestamp=index, color="all.jpg", sensors=sensors,
                T_world_camera=pose.tolist(),
            )  # fmt: skip
            records.append(record.model_dump_json())
        write_text(run.frames_path, f"[{','.join(records)}]")
        write_image(run.color_path("all.jpg"), np.full((120, 160, 3), (200, 120, 60), np.uint8))
        box_room.mesh().save(tmp_path / "reference.ply")
        run.save_manifest(
            Manifest(
                dataset="box", dataset_format="none", name="box", camera=box_room.camera.to_dict(), sensors=sensors,
                has_timestamps=False, reference_mesh=str(tmp_path / "reference.ply"),
            )
        )  # fmt: skip
        run.finish_stage("preprocess", "0", time.time(), {})
        Trajectory(np.arange(len(poses), dtype=float), np.array(poses)).save(run.reference_trajectory_path)
        return run

    return make


@pytest.fixture
def make_mappable_run(make_box_run: Callable[..., RunDirectory], box_room: BoxRoom) -> Callable[..., RunDirectory]:
    """The run of `make_box_run` with exact normals, which is all else that `uncle map` reads."""

    def make(sensors: tuple[str, ...] = ("gt", "noisy"), angles: np.ndarray | None = None) -> RunDirectory:
        run = make_box_run(sensors, angles)
        poses = Trajectory.load(run.reference_trajectory_path).T_world_camera
        for index, pose in enumerate(poses):
            for sensor in sensors:
                write_image(run.normal_path(sensor, index), encode_normals(box_room.normals(pose)))
        return run

    return make


def _write_depths(run: RunDirectory, room: BoxRoom, sensors: tuple[str, ...], index: int, pose: np.ndarray) -> None:
    true = room.depth(pose)
    beta = 0.01 * true**2
    noisy = np.maximum(true + np.random.default_rng(index).laplace(0.0, beta), 0.001)
    for sensor in sensors:
        depth = true if sensor == "gt" else noisy
        write_image(run.depth_path(sensor, index), encode_metres(depth, DEPTH_UNITS_PER_M))
        if sensor != "gt":
            write_image(run.beta_path(sensor, index), encode_metres(beta, BETA_UNITS_PER_M))


@pytest.fixture(params=[1, 2, 3])
def threads(request) -> Iterator[int]:
    """As many as PyTorch has during the test."""
    before = torch.get_num_threads()
    torch.set_num_threads(request.param)
    yield request.param
    torch.set_num_threads(before)


class BoxRecording:
    """A camera that moves sideways and turns in the box room."""

    name, format, sensors = "box", "none", ("depth",)
    has_poses, has_timestamps, reference_mesh, notes = True, False, None, ()
    registration_sigma_px = 0.0

    def __init__(self, room):
        self.room, self.camera = room, room.camera
        steps = np.linspace(0, 1, 30)
        self.poses = [
            room.pose(
                0.3 + 0.9 * s + 0.1 * np.sin(9 * s), (1.6 + 0.9 * s, 1.9 - 0.7 * s * s, 1.2 + 0.2 * np.sin(7 * s))
            )
            for s in steps
        ]

    def __len__(self):
        return len(self.poses)

    def __getitem__(self, index):
        depths = {sensor: self.depth(index, sensor) for sensor in self.sensors}
        return Frame(index, self.timestamp(index), self.color(index), depths, self.pose(index))

    def timestamp(self, index):
        return float(index)

    def pose(self, index):
        return self.poses[index]

    def color(self, index):
        return torch.from_numpy(self.room.picture(self.poses[index]))

    def depth(self, index, sensor):
        return torch.from_numpy(self.room.depth(self.poses[index]).astype(np.float32))


@pytest.fixture(scope="session")
def box_recording(box_room):
    return BoxRecording(box_room)
