"""Preprocessing of recordings made in memory, whole and damaged."""

import errno
import json
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
from uncle.recon.core import files as storage
from uncle.recon.core import normals as features
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import DataError, FrameError, RunError
from uncle.recon.core.events import Note, Progress, Warn
from uncle.recon.core.frame import Frame
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames
from uncle.recon.run.manifest import FrameRecord
from uncle.recon.stages import frame_conversion as conversion
from uncle.recon.stages import preprocess

CAMERA = Camera(48, 36, 40.0, 40.0, 23.5, 17.5)


@dataclass
class MemoryRecording:
    """Frame i looks at a tilted plane 1 + i/10 m away; `broken` holds each (index, "color" or sensor) that fails."""

    count: int = 6
    sensors: tuple[str, ...] = ("sl", "tof")
    broken: set[tuple[int, str]] = field(default_factory=set)
    empty: set[tuple[int, str]] = field(default_factory=set)
    bad_poses: set[int] = field(default_factory=set)
    name: str = "memory"
    format: str = "memory"
    camera: Camera = CAMERA
    has_poses: bool = True
    has_timestamps: bool = True
    reference_mesh: Path | None = None
    registration_sigma_px: float = 2.5
    notes: tuple[str, ...] = ("a note",)

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> Frame:
        depths = {sensor: self.depth(index, sensor) for sensor in self.sensors}
        return Frame(index, self.timestamp(index), self.color(index), depths, self.pose(index))

    def timestamp(self, index: int) -> float:
        return 100.0 + index / 30

    def pose(self, index: int) -> np.ndarray | None:
        if not self.has_poses:
            return None
        pose = np.eye(4)
        pose[0, 3] = np.nan if index in self.bad_poses else index
        return pose

    def color(self, index: int) -> torch.Tensor:
        self._check(index, "color")
        return torch.full((CAMERA.height, CAMERA.width, 3), 10 * index + 5, dtype=torch.uint8)

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        self._check(index, sensor)
        depth = 1 + index / 10 + 0.3 * CAMERA.rays()[..., 0]
        return torch.zeros_like(depth) if (index, sensor) in self.empty else depth

    def _check(self, index: int, part: str) -> None:
        if (index, part) in self.broken:
            raise FrameError(f"frame {index}: {part} is cut")


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    return RunDirectory(tmp_path / "run")


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    folder = tmp_path / "data"
    folder.mkdir()
    (folder / "image").write_text("one")
    return folder


@pytest.fixture
def convert(run, dataset):
    """Preprocess a recording; returns the summary and the events."""

    def call(recording, **options):
        events = []
        summary = preprocess.preprocess_run(recording, run, dataset=dataset, on_event=events.append, **options)
        return summary, events

    return call


def texts(events: list, kind: type) -> list[str]:
    return [event.text for event in events if isinstance(event, kind)]


def finish(run: RunDirectory, stage: str) -> None:
    run.finish_stage(stage, "x", 0.0, {})


def test_every_part_of_a_frame_arrives(run, convert):
    recording = MemoryRecording()
    summary, events = convert(recording)
    frames = RunFrames(run)
    assert (summary.frames, len(frames), frames.sensors) == (6, 6, ("sl", "tof"))
    progress = [event for event in events if isinstance(event, Progress) and event.stage == "preprocess"]
    assert [event.done for event in progress] == list(range(7))
    for index in range(6):
        assert abs(frames.color(index).float() - recording.color(index).float()).max() <= 2
        truth = recording.depth(index, "sl")
        assert (frames.depth(index, "sl") - truth).abs().max() <= 0.0005 + 1e-6
        expected = features.normals(features.smooth_depth(truth.numpy()), CAMERA)
        cosine = (frames.normals(index, "tof").numpy() * expected).sum(-1)
        assert cosine.min() > np.cos(np.radians(1.0))
        np.testing.assert_array_equal(frames.pose(index), recording.pose(index))
    assert [frames[i].timestamp for i in range(6)] == [recording.timestamp(i) for i in range(6)]
    reference = Trajectory.load(run.reference_trajectory_path)
    np.testing.assert_allclose(reference.T_world_camera[:, 0, 3], range(6))
    assert run.load_manifest().camera == CAMERA.to_dict()
    assert run.load_manifest().registration_sigma_px == RunFrames(run).registration_sigma_px == 2.5
    assert not (run.root / "frames.part").exists()


def test_frames_and_sensors_can_be_chosen(run, convert):
    summary, _ = convert(MemoryRecording(), frames=slice(1, None, 2), sensors=["tof"])
    frames = RunFrames(run)
    assert summary.sensors == frames.sensors == ("tof",)
    assert [record.source_index for record in frames.records] == [1, 3, 5]
    assert sorted(path.name for path in (run.root / "frames/depth").iterdir()) == ["tof"]


def test_lossless_colour_is_exact(run, convert):
    recording = MemoryRecording()
    convert(recording, lossless=True)
    assert (RunFrames(run).color(3) == recording.color(3)).all()


def test_bad_images_are_left_out_and_reported(run, convert):
    broken = {(0, "color"), (2, "sl"), (2, "tof"), (3, "sl")}
    summary, events = convert(MemoryRecording(broken=broken, empty={(4, "tof")}, bad_poses={5}))
    frames = RunFrames(run)
    assert [record.source_index for record in frames.records] == [1, 3, 4, 5]
    assert [record.sensors for record in frames.records] == [("sl", "tof"), ("tof",), ("sl",), ("sl", "tof")]
    assert [record.T_world_camera is None for record in frames.records] == [False, False, False, True]
    assert set(summary.skipped) == set(run.load_manifest().skipped) == {"0", "2", "3/sl", "4/tof"}
    warnings = texts(events, Warn)
    assert len(warnings) == 4
    assert "2 of 6 frames skipped" in warnings[0]
    assert "frame 0: color is cut" in warnings[0]
    assert not frames.depth(1, "sl").any()
    for index in range(4):  # the files were renumbered together with the records
        source = frames.records[index].source_index
        assert frames.color(index).float().mean() == pytest.approx(10 * source + 5, abs=2)
    assert len(Trajectory.load(run.reference_trajectory_path)) == 3


def test_frames_that_no_sensor_sees_are_kept_for_their_colour(run, convert):
    convert(MemoryRecording(empty={(1, "sl"), (1, "tof")}))
    assert RunFrames(run).records[1].sensors == ()


def test_depth_that_is_no_reading_becomes_zero():
    values = [np.nan, np.inf, -np.inf, -1.0, 0.0, 0.0004, 65.6, 65.5, 0.001]
    found = conversion.cleaned_depth(np.array([values], np.float32))
    np.testing.assert_allclose(found, [[0] * 7 + [65.5, 0.001]])
    assert found.dtype == np.float32


def test_a_frame_far_from_all_others_is_named_with_its_number_and_distance(convert, monkeypatch):
    recording = MemoryRecording(count=6)
    near = MemoryRecording.pose

    def pose(self, index):
        T = near(self, index)
        T[1, 3] += 1500.0 if index == 4 else 0.0
        return T

    monkeypatch.setattr(MemoryRecording, "pose", pose)
    _, events = convert(recording, frames=slice(1, 6), force=True)
    assert [text for text in texts(events, Warn) if "frame 4: 1500 m" in text]


def test_unchanged_is_kept_and_overwrite_redoes(run, convert, dataset):
    convert(MemoryRecording())
    before = run.frames_path.stat().st_mtime_ns
    finish(run, "map")
    summary, events = convert(MemoryRecording())
    assert summary.unchanged
    assert summary.frames == 6
    assert "--overwrite" in texts(events, Note)[0]
    assert run.frames_path.stat().st_mtime_ns == before
    assert set(run.load_manifest().stages) == {"preprocess", "map"}
    summary, events = convert(MemoryRecording(), overwrite=True)
    assert not summary.unchanged
    assert set(run.load_manifest().stages) == {"preprocess"}
    assert any("map" in text for text in texts(events, Warn))


@pytest.mark.parametrize("change", [{"frames": slice(0, 3)}, {"sensors": ["sl"]}, {"lossless": True}])
def test_other_settings_are_a_change(convert, change):
    convert(MemoryRecording())
    assert not convert(MemoryRecording(), **change)[0].unchanged


def test_a_changed_file_of_the_data_set_is_a_change(convert, dataset):
    convert(MemoryRecording())
    (dataset / "image").write_text("another")
    assert not convert(MemoryRecording())[0].unchanged


def test_a_change_behind_a_link_is_a_change(convert, dataset, tmp_path):
    for name in ("files", "others"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "image").write_text("one")
    (dataset / "folder").symlink_to(tmp_path / "files")
    (dataset / "folder" / "back").symlink_to(dataset)  # walked once
    (dataset / "file").symlink_to(tmp_path / "others" / "image")
    convert(MemoryRecording())
    assert convert(MemoryRecording())[0].unchanged
    (tmp_path / "files" / "image").write_text("three")
    assert not convert(MemoryRecording())[0].unchanged
    (tmp_path / "others" / "image").write_text("three")
    assert not convert(MemoryRecording())[0].unchanged
    (dataset / "folder").unlink()
    (dataset / "folder").symlink_to(tmp_path / "others")
    assert not convert(MemoryRecording())[0].unchanged


def test_another_camera_is_a_change(convert):
    convert(MemoryRecording())
    assert not convert(MemoryRecording(camera=replace(CAMERA, fx=41.0)))[0].unchanged


def test_depth_of_another_unit_is_named():
    assert conversion.reason_without_depth(np.zeros((2, 2))) == "no valid depth"
    assert "beyond 66 m (median 1500 m)" in conversion.reason_without_depth(np.full((2, 2), 1500.0))
    assert "nearer than a millimetre (median 0.0001 m)" in conversion.reason_without_depth(np.full((2, 2), 1e-4))


def test_a_run_inside_the_data_set_is_no_change_of_it(dataset):
    run = RunDirectory(dataset / "run")
    first = preprocess.preprocess_run(MemoryRecording(), run, dataset=dataset)
    second = preprocess.preprocess_run(MemoryRecording(), run, dataset=dataset)
    assert (first.unchanged, second.unchanged) == (False, True)


def contents(root: Path) -> dict[str, bytes]:
    return {str(path.relative_to(root)): path.read_bytes() for path in root.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("recording", "options", "words"),
    [
        (MemoryRecording(), {"sensors": ["sgm"]}, ["sgm", "sl, tof"]),
        (MemoryRecording(), {"frames": slice(10, 20)}, ["--frames", "6 frames"]),
        (MemoryRecording(broken={(i, "color") for i in range(6)}), {}, ["none of the 6", "color is cut"]),
        (MemoryRecording(empty={(i, "tof") for i in range(6)}), {}, ["tof", "--sensors sl"]),
    ],
)
def test_what_cannot_be_used_is_an_error_and_leaves_the_run_as_it_was(run, convert, recording, options, words):
    convert(MemoryRecording(count=4))
    finish(run, "map")
    before = contents(run.root)
    with pytest.raises(DataError) as caught:
        convert(recording, **options)
    assert all(word in str(caught.value) for word in words)
    assert contents(run.root) == before


def test_a_first_attempt_that_fails_leaves_nothing(run, convert):
    with pytest.raises(DataError):
        convert(MemoryRecording(broken={(i, "color") for i in range(6)}))
    assert not run.root.exists()


@pytest.mark.parametrize("good_writes", [0, 7])
def test_a_full_disk_costs_nothing_that_was_there(run, convert, monkeypatch, good_writes):
    convert(MemoryRecording(count=4))
    finish(run, "map")
    before = contents(run.root)
    writes = []

    def full(self, data):
        writes.append(self)
        if len(writes) > good_writes:
            raise OSError(errno.ENOSPC, "No space left on device")
        return len(data)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        patch.setattr(storage.os, "replace", lambda source, target: None)
        with pytest.raises(RunError, match="disk is full"):
            convert(MemoryRecording())
    assert contents(run.root) == before


def test_an_interrupted_attempt_is_cleared_away(run, convert):
    (run.root / "frames.part" / "frames").mkdir(parents=True)
    (run.root / "frames.part" / "frames" / "half.png").write_bytes(b"half")
    convert(MemoryRecording())
    assert not (run.root / "frames.part").exists()
    assert len(RunFrames(run)) == 6


def test_a_kill_between_old_and_new_frames_is_noticed(run, convert, monkeypatch):
    convert(MemoryRecording(count=4))

    def killed(*args):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Trajectory, "save", killed)
        with pytest.raises(KeyboardInterrupt):
            convert(MemoryRecording())
    with pytest.raises(RunError, match="uncle preprocess"):
        RunFrames(run)
    assert not convert(MemoryRecording())[0].unchanged


@pytest.mark.parametrize("text", ["not json", json.dumps({"schema_version": 0}), json.dumps({"schema_version": 1})])
def test_a_damaged_manifest_is_redone(run, convert, text):
    convert(MemoryRecording())
    run.manifest_path.write_text(text)
    convert(MemoryRecording())
    assert len(RunFrames(run)) == 6


def test_folders_of_others_are_not_touched(run, convert, dataset):
    run.frames_path.parent.mkdir(parents=True)
    (run.frames_path.parent / "precious").write_text("mine")
    with pytest.raises(RunError, match="not part of a run"):
        convert(MemoryRecording())
    assert (run.frames_path.parent / "precious").exists()
    with pytest.raises(RunError, match="data set itself"):
        preprocess.preprocess_run(MemoryRecording(), RunDirectory(dataset), dataset=dataset)


def test_poses_that_are_gone_take_their_trajectory_with_them(run, convert):
    convert(MemoryRecording())
    _, events = convert(MemoryRecording(has_poses=False), overwrite=True)
    assert not run.reference_trajectory_path.exists()
    assert not texts(events, Warn)


def test_threads_of_opencv_are_as_before(convert):
    cv2.setNumThreads(2)
    convert(MemoryRecording())
    assert cv2.getNumThreads() == 2


def test_records_are_plain_json(run, convert):
    convert(MemoryRecording())
    rows = json.loads(run.frames_path.read_text())
    assert [FrameRecord.model_validate(row).index for row in rows] == list(range(6))
