"""`map` with tracking as a library user meets it: good recordings, and whatever else frames may show."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from uncle.datasets.synth.path import FreeSpace, handheld_path
from uncle.datasets.synth.render import Renderer
from uncle.datasets.synth.room import furnished_room
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.errors import DataError
from uncle.recon.core.events import Progress, Warn
from uncle.recon.core.files import DEPTH_UNITS_PER_M, encode_metres, write_image, write_text
from uncle.recon.core.normals import normals, smooth_depth
from uncle.recon.core.se3 import inverse
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import encode_normals
from uncle.recon.run.manifest import FrameRecord, Manifest
from uncle.recon.run.tracking_record import TrackingRecord
from uncle.recon.stages import map as map_stage
from uncle.recon.stages.map import map_run
from uncle.recon.stages.mesh import mesh_run
from uncle.recon.tracking.tracker import AlignTracker

CAMERA = Camera(160, 120, 95.0, 95.0, 79.5, 59.5)
QUICK = [
    "fusion.voxel_size_m=0.04",
    "fusion.min_observations=1",
    "keyframes.rays=200",
    "field.iterations=3",
    "field.rays=128",
    "uncertainty.steps_per_keyframe=2",
    "uncertainty.steps_per_pass=20",
    "uncertainty.batch=512",
]
FRAMES = 24


@dataclass(frozen=True)
class Shot:
    """color (H, W, 3) uint8; exact depth (H, W) metres; where it was taken from (4, 4)."""

    color: np.ndarray
    depth: np.ndarray
    pose: np.ndarray

    def black(self) -> Shot:
        return replace(self, color=np.zeros_like(self.color))

    def blind(self) -> Shot:
        """Without any depth."""
        return replace(self, depth=np.zeros_like(self.depth))


def shoot(seed: int, count: int) -> list[Shot]:
    """A walk through the furnished room of `seed`."""
    scene = furnished_room(seed)
    renderer = Renderer(scene, CAMERA, np.random.default_rng(seed))
    free = FreeSpace.find(renderer.raycaster, *scene.bounds)
    views = [(renderer.render(pose), pose) for pose in handheld_path(free, count, np.random.default_rng(seed + 1))]
    return [Shot(np.clip(np.rint(v.color), 0, 255).astype(np.uint8), v.depth, pose) for v, pose in views]


@pytest.fixture(scope="session")
def walk() -> list[Shot]:
    return shoot(0, FRAMES)


@pytest.fixture(scope="session")
def elsewhere() -> list[Shot]:
    """Another room."""
    return shoot(5, 8)


def noisy(depth: np.ndarray, index: int, sensor: int) -> np.ndarray:
    """A sensor that errs by Laplace noise that grows with depth."""
    rng = np.random.default_rng([index, sensor])
    error = rng.laplace(0.0, (0.002, 0.006)[sensor] * depth**2)
    return np.where(depth > 0, np.maximum(depth + error, 0.05), 0.0).astype(np.float32)


@pytest.fixture
def record(tmp_path: Path) -> Callable[..., RunDirectory]:
    """Writes a run as `uncle preprocess` would. `missing` holds (index, sensor) without an image."""

    def write(
        shots: Sequence[Shot], sensors: tuple[str, ...] = ("a",), posed: bool = True, missing: Sequence = (),
        name: str = "run", registration_sigma_px: float = 0.0,
    ) -> RunDirectory:  # fmt: skip
        run, records = RunDirectory(tmp_path / name), []
        for index, shot in enumerate(shots):
            write_image(run.color_path(f"{index}.png"), shot.color)
            present = tuple(s for s in sensors if (index, s) not in missing)
            for number, sensor in enumerate(sensors):
                depth = noisy(shot.depth, index, number)
                if sensor in present:
                    write_image(run.depth_path(sensor, index), encode_metres(depth, DEPTH_UNITS_PER_M))
                    surface = normals(smooth_depth(depth), CAMERA)
                    write_image(run.normal_path(sensor, index), encode_normals(surface))
            row = FrameRecord(
                index=index, source_index=index, timestamp=index / 30, color=f"{index}.png", sensors=present,
                T_world_camera=shot.pose.tolist() if posed else None,
            )  # fmt: skip
            records.append(row.model_dump_json())
        write_text(run.frames_path, f"[{','.join(records)}]")
        manifest = Manifest(
            dataset="room", dataset_format="none", name="room", camera=CAMERA.to_dict(), sensors=sensors,
            has_timestamps=True, reference_mesh=None, registration_sigma_px=registration_sigma_px,
        )  # fmt: skip
        run.save_manifest(manifest)
        run.finish_stage("preprocess", "0", time.time(), {})
        return run

    return write


@dataclass(frozen=True)
class Tracked:
    """What a run with tracking says."""

    run: RunDirectory
    record: TrackingRecord
    warnings: list[str]
    poses: dict[int, np.ndarray]

    @property
    def statuses(self) -> list[str]:
        return [f.status for f in self.record.frames]

    def where(self, *statuses: str) -> list[int]:
        return [f.index for f in self.record.frames if f.status in statuses]

    def ate_m(self, shots: Sequence[Shot], among: Sequence[int] | None = None) -> float:
        """RMSE of the positions against the truth, no alignment: both begin at the same pose."""
        indices = [i for i in self.poses if among is None or i in among]
        off = [self.poses[i][:3, 3] - shots[i].pose[:3, 3] for i in indices]
        return float(np.sqrt(np.mean(np.square(off).sum(1))))


def settings(*overrides: str, method: str = "uncle", **top_level):
    quick = QUICK if method == "uncle" else ["fusion.min_observations=1", "fusion.voxel_size_m=0.04"]
    return make_config(method, ["tracking.enabled=true", *quick, *overrides], device="cpu", **top_level)


def track(run: RunDirectory, *overrides: str, **options) -> Tracked:
    """Map with tracking, and check what must hold whatever the frames show."""
    events: list = []
    map_run(run, settings(*overrides, **options), on_event=events.append)
    trajectory = Trajectory.load(run.trajectory_path)
    record = TrackingRecord.load(run.tracking_path)
    found = [f for f in record.frames if f.status != "lost"]
    np.testing.assert_allclose(trajectory.timestamps, [f.timestamp for f in found], atol=1e-6)
    assert np.isfinite(trajectory.T_world_camera).all()
    for frame in record.frames:
        assert (frame.covariance is None) == (frame.status == "lost")
        if frame.covariance is not None:
            covariance = np.array(frame.covariance)
            assert covariance.shape == (6, 6)
            assert np.isfinite(covariance).all()
            assert np.linalg.eigvalsh((covariance + covariance.T) / 2).min() > -1e-9
    poses = {f.index: pose for f, pose in zip(found, trajectory.T_world_camera, strict=True)}
    said = [e.text for e in events if isinstance(e, Warn)]
    lost = record.counts()["lost"]
    assert sum(f"lost in {lost} of {len(record.frames)} frames" in text for text in said) == bool(lost)
    return Tracked(run, record, said, poses)


# --- good recordings -------------------------------------------------------------------------------------------
def test_a_walk_is_followed(walk, record):
    result = track(record(walk))
    assert result.statuses == ["tracked"] * FRAMES
    assert result.ate_m(walk) < 0.008
    np.testing.assert_allclose(result.poses[0], walk[0].pose, atol=1e-6)
    assert result.run.load_manifest().stages["map"].facts["tracking"]["tracked"] == FRAMES
    assert result.warnings == []


def test_without_given_poses_the_first_is_identity(walk, record):
    result = track(record(walk, posed=False))
    np.testing.assert_allclose(result.poses[0], np.eye(4), atol=1e-9)
    start = inverse(walk[0].pose)
    moved = [replace(shot, pose=start @ shot.pose) for shot in walk]
    assert result.ate_m(moved) < 0.008


def test_two_sensors_one_of_which_pauses(walk, record):
    missing = [(index, "a") for index in range(8, 13)]
    result = track(record(walk, ("a", "b"), missing=missing))
    assert result.where("lost") == []
    assert result.ate_m(walk) < 0.008


def test_depth_alone(walk, record):
    """The room is seen as a corner with furniture, which holds all directions."""
    result = track(record(walk), "tracking.color=false")
    assert result.where("lost") == []
    assert result.ate_m(walk) < 0.06
    assert all(f.matches == 0 for f in result.record.frames)


def test_depth_alone_where_colour_is_badly_registered(walk, record):
    """An error of the registration concerns features alone, of which there are none."""
    results = [track(record(walk[:8], name=f"run_{px}", registration_sigma_px=px), "tracking.color=false")
               for px in (0.0, 3.0)]  # fmt: skip
    assert results[1].where("lost") == []
    for index, pose in results[0].poses.items():
        np.testing.assert_allclose(results[1].poses[index], pose, atol=1e-3)


def test_too_few_features_where_colour_is_badly_registered(walk, record):
    """Colour in a corner of the image only: a few features, and no frame has enough of them to be adjusted."""
    shots = []
    for shot in walk[:8]:
        color = np.zeros_like(shot.color)
        color[40:64, 40:64] = shot.color[40:64, 40:64]
        shots.append(replace(shot, color=color))
    result = track(record(shots, registration_sigma_px=3.0))
    assert result.where("lost") == []
    assert result.ate_m(shots) < 0.06


def test_baseline_tracks_by_features(walk, record):
    result = track(record(walk), method="tsdf")
    assert result.where("lost") == []
    assert result.ate_m(walk) < 0.01


def test_frames_held_out_are_not_tracked(walk, record):
    result = track(record(walk), hold_out=5)
    assert [f.index for f in result.record.frames] == [i for i in range(FRAMES) if i % 5 != 4]
    assert result.ate_m(walk) < 0.01


def test_a_map_with_given_poses_has_no_tracking_record(walk, record):
    run = record(walk[:4])
    track(run)
    map_run(run, settings("tracking.enabled=false"))
    assert not run.tracking_path.exists()
    assert "tracking" not in run.load_manifest().stages["map"].facts


class Broken(Exception):
    """Stands for whatever ends a process."""


def results(run: RunDirectory) -> dict[str, bytes]:
    mesh_run(run, overwrite=True)
    return {p.name: p.read_bytes() for p in (run.mesh_path, run.trajectory_path, run.tracking_path, run.curves_path)}


def test_broken_run_resumes_to_the_same_bytes(walk, record, monkeypatch):
    monkeypatch.setattr(map_stage, "Checkpoint", partial(Checkpoint, interval_s=0.0))
    run = record(walk[:10])
    track(run)
    expected = results(run)

    def break_at(stage: str, done: int, event: object) -> None:
        if isinstance(event, Progress) and event.stage.startswith(stage) and event.done == done:
            raise Broken

    for stage, done in (("tracking and mapping", 6), ("integrating", 4)):
        with pytest.raises(Broken):
            map_run(run, settings(), overwrite=True, on_event=partial(break_at, stage, done))
        map_run(run, settings(), resume=True)
        assert results(run) == expected, stage


def test_what_fails_after_the_last_frame_can_be_resumed(walk, record, monkeypatch):
    """Tracking takes less time than from one checkpoint to the next; still, resuming tracks no frame again."""
    undisturbed, run = record(walk[:8], name="undisturbed"), record(walk[:8])
    map_run(undisturbed, settings())

    def fail(*_: object) -> None:
        raise Broken

    with monkeypatch.context() as patched:
        patched.setattr(AlignTracker, "finish", fail)
        with pytest.raises(Broken):
            map_run(run, settings())
    monkeypatch.setattr(AlignTracker, "track", fail)
    map_run(run, settings(), resume=True)
    assert results(run) == results(undisturbed)


# --- whatever frames show --------------------------------------------------------------------------------------
def test_black_images_are_carried_by_depth(walk, record):
    """Depth alone is weaker than features, but no reason to give up."""
    result = track(record([shot.black() if 8 <= i < 12 else shot for i, shot in enumerate(walk)]))
    assert result.where("lost") == []
    assert result.where("weak") == [8, 9, 10, 11]
    assert result.ate_m(walk) < 0.02
    covariances = [np.trace(np.array(f.covariance)) for f in result.record.frames]
    assert min(covariances[8:12]) > covariances[7]


def test_all_black(walk, record):
    result = track(record([shot.black() for shot in walk]))
    assert result.where("lost") == []
    assert result.ate_m(walk) < 0.06


def test_a_blank_wall_does_not_move_the_camera(walk, record):
    """One colour, one plane: nothing says where along it the camera is, so it is left where it was."""
    wall = Shot(np.full_like(walk[0].color, 180), np.full_like(walk[0].depth, 1.5), np.eye(4))
    result = track(record([wall] * 12))
    assert set(result.where("tracked")) <= {0}
    assert result.ate_m([wall] * 12) < 0.03


@pytest.mark.parametrize("blind", [range(8, 12), range(3)], ids=["middle", "first"])
def test_frames_without_depth(walk, record, blind):
    """A frame that only shows colour has a place against what is known, and none before anything is."""
    result = track(record([shot.blind() if i in blind else shot for i, shot in enumerate(walk)]))
    assert set(result.where("lost")) <= set(blind)
    if 0 in blind:
        assert result.where("lost") == list(blind)
        np.testing.assert_allclose(result.poses[3], walk[3].pose, atol=1e-6)
    else:
        assert result.ate_m(walk) < 0.01


@pytest.mark.parametrize(("color", "most_m"), [("true", 0.01), ("false", 0.03)])
def test_a_jump_is_lost_and_found_again(walk, elsewhere, record, color, most_m):
    """What the lost camera saw is not in the map; the warning says which frames it was."""
    shots = [*walk[:12], *elsewhere[:3], *walk[6:]]
    result = track(record(shots), f"tracking.color={color}")
    assert result.where("lost") == [12, 13, 14]
    assert result.where("relocalised") == [15]
    assert result.ate_m(shots) < most_m
    assert [text for text in result.warnings if text.endswith("12 to 14")]
    assert not set(result.poses) & {12, 13, 14}


def test_a_second_recording_leaves_the_first_unharmed(walk, elsewhere, record):
    result = track(record([*walk[:12], *elsewhere]))
    assert result.where("lost") == list(range(12, 20))
    assert result.ate_m(walk) < 0.01


def test_identical_frames_do_not_drift(walk, record):
    result = track(record([walk[0]] * 60), "tracking.integrate_every=10")
    assert result.where("lost", "relocalised") == []
    assert result.ate_m([walk[0]] * 60) < 0.001


@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_frames(walk, record, count):
    result = track(record(walk[:count]))
    assert len(result.poses) == count
    assert result.ate_m(walk) < 0.005


@pytest.mark.parametrize("method", ["uncle", "tsdf"])
def test_nothing_to_see_is_said(walk, record, method):
    """A data error with what to do, and no record of a map."""
    run = record([shot.blind().black() for shot in walk[:4]])
    with pytest.raises(DataError, match="lost in all 4 frames"):
        map_run(run, settings(method=method))
    assert "map" not in run.load_manifest().stages
