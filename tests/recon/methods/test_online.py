"""The shared loop of systems that optimise a field frame by frame, driven by a system that a person can follow."""

from functools import partial

import numpy as np
import pytest
import torch
from uncle.recon.core.errors import DataError
from uncle.recon.core.events import Progress
from uncle.recon.core.tensor_files import load_tensors
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.methods.online import Found
from uncle.recon.methods.registry import method_spec, register_method, unregister_method
from uncle.recon.methods.spec import MethodSpec
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.frames import RunFrames
from uncle.recon.run.tracking_record import TrackingRecord
from uncle.recon.stages import map as map_stage
from uncle.recon.stages.map import load_field, map_run
from uncle.recon.volume.neural_field import NeuralField
from uncle.recon.volume.sparse_grid import SparseGrid

calls = []


class Plane:
    """Its map is a plane whose height is a random walk that depends on every frame that was mapped, in order."""

    map_every = 5
    learns_uncertainty = True

    def __init__(self, frames, config, device):
        self.frames, self.config, self.height = frames, config, torch.zeros(())
        self.generator = torch.Generator().manual_seed(config.seed)
        self.mapped = []

    def begin(self, indices, on_event):
        calls.append("begin")

    def prepare(self, frame):
        return float(next(iter(frame.depths.values())).mean())

    def track(self, frame, prepared, recent):
        calls.append(("track", frame.index, len(recent)))
        if frame.index == 4:
            return Found(None, "lost")
        T = recent[-1].copy()
        T[0, 3] += 0.01 * prepared
        return Found(T)

    def map(self, frame, prepared, T_world_camera, last):
        calls.append(("map", frame.index, last))
        step = torch.rand((), generator=self.generator)
        self.height = 0.9 * self.height + 0.1 * step * prepared + 0.01 * T_world_camera[0, 3]
        self.mapped.append(frame.index)
        lifted = np.array(T_world_camera)
        lifted[1, 3] += float(step)
        return {frame.index: lifted, 99: lifted} if self.config.tracking.enabled else {}

    def betas(self, frame, prepared):
        return {sensor: (depth > 0) * self.height.abs() for sensor, depth in frame.depths.items()}

    def field(self, poses, on_event):
        grid = SparseGrid(0.1)
        grid.allocate(torch.zeros(1, 3, dtype=torch.int64))
        height = grid.block_positions(torch.tensor([0])).view(-1, 3)[:, 2] - self.height
        base = torch.cat([height[:, None], torch.zeros(len(height), 3)], 1).float()
        known = torch.ones(len(base), dtype=torch.bool)
        plain = self.config.field.model_copy(update={"levels": ()})
        return NeuralField(grid, base, base[:, 0].abs(), known, plain, torch.Generator())

    def curves(self):
        return {"noise/gt": [float(self.height)]}

    def keyframes(self):
        return len(self.mapped)

    def artifacts(self):
        return {"height": self.height}

    def state_dict(self):
        return {"height": self.height, "mapped": self.mapped, "generator": self.generator.get_state()}

    def load_state_dict(self, state):
        self.height, self.mapped = state["height"], list(state["mapped"])
        self.generator.set_state(state["generator"])


@pytest.fixture(autouse=True)
def plane_system(monkeypatch):
    register_method(MethodSpec(name="plane", summary="a plane", kind="online", implementation=Plane))
    monkeypatch.setattr(map_stage, "Checkpoint", partial(Checkpoint, interval_s=0.0))
    calls.clear()
    yield
    unregister_method("plane")


def settings(track: bool = False, **top_level):
    overrides = [f"tracking.enabled={str(track).lower()}"]
    return method_spec("plane").configure(overrides, sensors=("gt",), device="cpu", **top_level)


def results(run):
    paths = [run.trajectory_path, run.curves_path, *sorted((run.root / "beta").rglob("*.png"))]
    fields = load_field(run).base.numpy().tobytes() + load_tensors(run.method_state_path)["height"].numpy().tobytes()
    return [path.read_bytes() for path in paths] + [fields]


def test_given_poses_map_every_fifth_frame_and_the_last(make_mappable_run):
    run = make_mappable_run()
    assert map_run(run, settings()).frames == 12
    assert calls == ["begin", *(("map", i, i == 11) for i in (0, 5, 10, 11))]
    true = Trajectory.load(run.reference_trajectory_path).T_world_camera
    np.testing.assert_allclose(Trajectory.load(run.trajectory_path).T_world_camera, true, atol=1e-6)
    record = run.load_manifest().stages["map"]
    assert record.facts["keyframes"] == 4
    assert set(record.facts["seconds"]) == {"mapping", "surface", "beta maps"}
    assert len(list((run.root / "beta").rglob("*.png"))) == 12
    assert RunFrames(run).beta(7, "gt").max() == pytest.approx(
        float(load_tensors(run.method_state_path)["height"]), abs=1e-4
    )
    assert not run.checkpoint_path.exists()


def test_held_out_frames_are_neither_mapped_nor_counted(make_mappable_run):
    map_run(make_mappable_run(), settings(hold_out=6))
    assert [call[1] for call in calls[1:]] == [0, 6, 10]  # 5 and 11 are held out


def test_tracking_starts_at_the_first_pose_and_goes_on_after_a_loss(make_mappable_run):
    run = make_mappable_run()
    assert map_run(run, settings(track=True)).frames == 11
    assert [call for call in calls if call[0] == "track"][:3] == [("track", 1, 1), ("track", 2, 2), ("track", 3, 2)]
    assert [call[1] for call in calls if call[0] == "map"] == [0, 5, 10, 11]
    tracked = TrackingRecord.load(run.tracking_path)
    assert tracked.counts() == {"tracked": 11, "weak": 0, "lost": 1, "relocalised": 0}
    found = Trajectory.load(run.trajectory_path)
    assert 4.0 not in found.timestamps
    first = np.array(RunFrames(run).pose(0))
    np.testing.assert_allclose(found.T_world_camera[0, [0, 2], 3], first[[0, 2], 3], atol=1e-6)
    assert found.T_world_camera[0, 1, 3] > first[1, 3]  # what mapping moved is recorded, and tracked from
    assert found.T_world_camera[1, 1, 3] == pytest.approx(found.T_world_camera[0, 1, 3])


def test_a_frame_that_was_due_while_lost_is_mapped_when_found_again(make_mappable_run, monkeypatch):
    monkeypatch.setattr(Plane, "map_every", 4)
    map_run(make_mappable_run(), settings(track=True))
    assert [call[1] for call in calls if call[0] == "map"] == [0, 5, 9, 11]


class Broken(Exception):
    """Stands for whatever ends a process."""


@pytest.mark.parametrize(("track", "breaks"), [(False, (5, 11)), (True, (3, 6, 11))])
def test_broken_run_ends_as_an_unbroken_one(make_mappable_run, track, breaks):
    run = make_mappable_run()
    map_run(run, settings(track))
    expected = results(run)
    for stage, at in [*(("", at) for at in breaks), ("writing beta maps", 3)]:

        def stop(event, stage=stage, at=at):
            if isinstance(event, Progress) and event.stage.endswith(stage or "mapping") and event.done == at:
                raise Broken

        with pytest.raises(Broken):
            map_run(run, settings(track), overwrite=True, on_event=stop)
        calls.clear()
        map_run(run, settings(track), resume=True)
        assert "begin" not in calls
        assert results(run) == expected, (stage, at)


def test_lost_everywhere_is_an_error(make_mappable_run, monkeypatch):
    monkeypatch.setattr(RunFrames, "depth", lambda self, index, sensor: torch.zeros(120, 160))
    monkeypatch.setattr(Plane, "track", lambda *_: Found(None, "lost"))
    with pytest.raises(DataError, match="lost in all 12 frames"):
        map_run(make_mappable_run(), settings(track=True))
