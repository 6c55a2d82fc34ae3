"""The whole chain on a room in map coordinates (UTM): the same results as at the origin, in the world of the data."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.events import Note
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.core.world_offset import NO_OFFSET
from uncle.recon.evaluation.surface_metrics import EvaluationSettings
from uncle.recon.methods.registry import method_spec
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames
from uncle.recon.stages.evaluate import evaluate_mesh_file, evaluate_run
from uncle.recon.stages.map import map_run
from uncle.recon.stages.mesh import mesh_run
from uncle.recon.stages.preprocess import preprocess_run
from uncle.recon.stages.report import report_run
from uncle.recon.stages.snapshot import SnapshotSettings, snapshot_file
from uncle.recon.visualization import report_sections
from uncle.recon.visualization.mesh_pictures import snapshot_views

UTM = np.array([500_123.25, 4_512_340.5, 131.125])
OFFSET = (500_130.0, 4_512_340.0, 130.0)
SETTINGS = EvaluationSettings(samples=20_000, views=0, thresholds_m=(0.02,))


@dataclass
class RoomRecording:
    """A turn in the box room, which stands at `place` in the world."""

    room: object
    place: np.ndarray
    reference_mesh: Path
    count: int = 8
    sensors: tuple[str, ...] = ("gt",)
    name: str = "room"
    format: str = "memory"
    has_poses: bool = True
    has_timestamps: bool = False
    registration_sigma_px: float = 0.0
    notes: tuple[str, ...] = ()

    @property
    def camera(self) -> Camera:
        return self.room.camera

    def __len__(self) -> int:
        return self.count

    def timestamp(self, index: int) -> float:
        return float(index)

    def _near(self, index: int) -> np.ndarray:
        return self.room.pose(2 * np.pi * index / self.count)

    def pose(self, index: int) -> np.ndarray:
        pose = self._near(index)
        pose[:3, 3] += self.place
        return pose

    def color(self, index: int) -> torch.Tensor:
        return torch.from_numpy(self.room.picture(self._near(index)))

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        return torch.from_numpy(self.room.depth(self._near(index))).float()


def reconstruct(folder: Path, room, place) -> tuple[RunDirectory, list]:
    folder.mkdir()
    true = replace(room.mesh(), offset_m=tuple(place))
    true.save(folder / "true.ply")
    run, events = RunDirectory(folder / "run"), []
    recording = RoomRecording(room, place, folder / "true.ply")
    preprocess_run(recording, run, dataset=folder, on_event=events.append)
    config = method_spec("tsdf").configure(["fusion.voxel_size_m=0.05", "fusion.min_observations=1"], device="cpu")
    map_run(run, config)
    mesh_run(run)
    return run, events


@pytest.fixture(scope="module")
def runs(tmp_path_factory, box_room):
    folder = tmp_path_factory.mktemp("worlds")
    return reconstruct(folder / "near", box_room, np.zeros(3)), reconstruct(folder / "far", box_room, UTM)


def test_the_offset_is_told_and_recorded(runs):
    (near, near_events), (far, events) = runs
    assert near.load_manifest().world_offset_m == NO_OFFSET
    assert not [event for event in near_events if "far from its origin" in getattr(event, "text", "")]
    assert far.load_manifest().world_offset_m == OFFSET
    assert Note("the world lies far from its origin: inside the run, coordinates are relative to "
                "(500 130, 4 512 340, 130) m") in events  # fmt: skip
    assert np.abs(RunFrames(far).known_pose(0)[:3, 3]).max() < 20


def test_outputs_are_in_the_world_of_the_data(runs):
    (near, _), (far, _) = runs
    for path in (far.trajectory_path, far.reference_trajectory_path):
        poses = Trajectory.load(path).T_world_camera
        expected = Trajectory.load(near.trajectory_path).T_world_camera
        np.testing.assert_allclose(poses[:, :3, 3], expected[:, :3, 3] + UTM, atol=1e-6, rtol=0)
    assert b"property double x" in far.mesh_path.read_bytes()
    mesh, there = Mesh.load(near.mesh_path), Mesh.load(far.mesh_path)
    middle = there.vertices.astype(np.float64).mean(0) + there.offset_m
    np.testing.assert_allclose(middle, mesh.vertices.mean(0) + UTM, atol=0.02, rtol=0)


def test_scores_are_those_of_the_same_room_at_the_origin(runs):
    near, far = (evaluate_run(run, SETTINGS).metrics for run, _ in runs)
    assert near.surface.mesh.scores[0].f_score > 0.5
    assert far.surface.mesh.scores[0].f_score == pytest.approx(near.surface.mesh.scores[0].f_score, abs=0.01)
    assert far.surface.mesh.accuracy_mean_m == pytest.approx(near.surface.mesh.accuracy_mean_m, abs=5e-4)
    assert far.trajectory.ate_m.max < 1e-6


def test_files_far_away_are_scored_and_drawn_without_a_run(runs, tmp_path):
    _, (far, _) = runs
    reference = far.root.parent / "true.ply"
    for cull in (None, far):
        metrics = evaluate_mesh_file(far.mesh_path, reference, SETTINGS, cull=cull, error_mesh=tmp_path / "error.ply")
        assert metrics.mesh.accuracy_mean_m < 0.01
    assert np.linalg.norm(np.subtract(Mesh.load(tmp_path / "error.ply").offset_m, UTM)) < 20
    small = SnapshotSettings(size=(64, 48), renderer="raycast")
    assert snapshot_file(far.mesh_path, tmp_path / "pictures", far, reference, settings=small)


def test_the_report_of_a_world_far_away_is_whole(runs, monkeypatch):
    _, (far, _) = runs
    monkeypatch.setattr(report_sections, "snapshot_views", partial(snapshot_views, size=(64, 48)))
    evaluate_run(far, SETTINGS)
    events = []
    report_run(far, "raycast", events.append)
    assert not [event for event in events if type(event).__name__ == "Warn"]
