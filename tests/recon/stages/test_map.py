"""`map` end to end on the box room: what is written, what is refused, and that a broken run ends as an unbroken one."""

import json
import os
import shutil
import signal
import subprocess
import sys
import tomllib
from functools import partial

import numpy as np
import pytest
from uncle.recon.core.config.map_config import MapConfig, make_config
from uncle.recon.core.errors import ConfigError, DataError, RunError
from uncle.recon.core.events import Note, Progress, Warn
from uncle.recon.core.files import write_text
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.mesh_raycaster import Surface
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames
from uncle.recon.stages import map as map_stage
from uncle.recon.stages.map import load_field, map_run
from uncle.recon.stages.mesh import mesh_run

QUICK = [
    "fusion.voxel_size_m=0.05",
    "fusion.passes=1",
    "fusion.min_observations=2",
    "keyframes.rays=500",
    "field.iterations=15",
    "field.rays=256",
    "uncertainty.steps_per_keyframe=4",
    "uncertainty.steps_per_pass=80",
    "uncertainty.batch=512",
]


def settings(*overrides: str, method: str = "uncle", **top_level) -> MapConfig:
    return make_config(
        method, [*QUICK, *overrides] if method == "uncle" else list(overrides), device="cpu", **top_level
    )


def strip_poses(run: RunDirectory, indices: list[int]) -> None:
    records = json.loads(run.frames_path.read_text())
    for index in indices:
        records[index]["T_world_camera"] = None
    write_text(run.frames_path, json.dumps(records))


def distances(run: RunDirectory, reference: Mesh) -> np.ndarray:
    """(V,) metres from the vertices of the run's mesh to the true walls."""
    mesh_run(run, overwrite=True)
    return Surface(reference).distance(Mesh.load(run.mesh_path).vertices)


def test_two_sensors_end_to_end(make_mappable_run, box_room):
    run = make_mappable_run()
    summary = map_run(run, settings("uncertainty.learning_rate=0.01", sensors=("gt", "noisy")))
    assert summary.frames == 12
    assert not summary.unchanged
    off = distances(run, box_room.mesh())
    assert len(off) > 2000
    assert off.mean() < 0.012
    assert np.quantile(off, 0.95) < 0.03
    beta = {
        sensor: np.median([RunFrames(run).beta(i, sensor).median() for i in range(12)]) for sensor in ("gt", "noisy")
    }
    assert beta["gt"] < 0.7 * beta["noisy"]
    trajectory = Trajectory.load(run.trajectory_path)
    true = Trajectory.load(run.reference_trajectory_path)
    np.testing.assert_allclose(trajectory.T_world_camera, true.T_world_camera, atol=1e-6)
    recorded = tomllib.loads(run.config_path.read_text())
    assert recorded["sensors"] == ["gt", "noisy"]
    assert recorded["fusion"]["voxel_size_m"] == 0.05
    curves = json.loads(run.curves_path.read_text())
    assert {"noise/gt", "noise/noisy", "refinement"} <= set(curves)
    assert len(curves["refinement"]["y"]) == 15
    facts = run.load_manifest().stages["map"].facts
    assert (facts["method"], facts["frames"], facts["held_out"], facts["seed"]) == ("uncle", 12, [], 0)
    assert not run.checkpoint_path.exists()


@pytest.mark.parametrize("overrides", [["uncertainty.enabled=false"], ["field.levels=[]"], ["fusion.passes=0"]])
def test_parts_can_be_switched_off(make_mappable_run, box_room, overrides):
    run = make_mappable_run(("gt",))
    map_run(run, settings(*overrides))
    assert distances(run, box_room.mesh()).mean() < 0.01
    assert run.beta_path("gt", 0).exists() == (overrides != ["uncertainty.enabled=false"])


def test_baseline_end_to_end(make_mappable_run, box_room):
    run = make_mappable_run(("gt",))
    map_run(run, settings("fusion.voxel_size_m=0.05", "fusion.min_observations=1", method="tsdf"))
    assert distances(run, box_room.mesh()).mean() < 0.01
    assert not run.beta_path("gt", 0).exists()


def test_voxel_size_is_chosen_told_and_recorded(make_mappable_run):
    """The room is 2 m deep, so that its voxels are 2 cm; the same size given by hand is the same map."""
    run, events = make_mappable_run(("gt",)), []
    few = ("fusion.min_observations=1", "hold_out=2")
    map_run(run, settings(*few, method="tsdf"), on_event=events.append)
    assert any("voxel size 2 cm (median depth " in event.text for event in events if isinstance(event, Note))
    assert tomllib.loads(run.config_path.read_text())["fusion"]["voxel_size_m"] == 0.02
    assert load_field(run).grid.voxel_size_m == pytest.approx(0.02)
    assert run.load_manifest().stages["map"].facts["voxel_size"]["metres"] == 0.02
    assert map_run(run, settings(*few, "fusion.voxel_size_m=0.02", method="tsdf")).unchanged


def test_nothing_is_left_of_an_earlier_map(make_mappable_run):
    """Beta maps and curves belong to the map at hand, not to the one before."""
    run = make_mappable_run()
    map_run(run, settings(sensors=("gt", "noisy")))
    assert run.beta_path("gt", 0).exists()
    map_run(run, settings(sensors=("noisy",)))
    assert not run.beta_path("gt", 0).exists()
    assert run.beta_path("noisy", 0).exists()
    map_run(run, settings("fusion.voxel_size_m=0.05", "fusion.min_observations=1", method="tsdf"))
    assert not run.beta_path("noisy", 0).exists()
    assert not run.curves_path.exists()


def test_done_and_unchanged(make_mappable_run):
    run = make_mappable_run(("noisy",))
    assert not map_run(run, settings()).unchanged
    before = run.field_path.stat().st_mtime_ns
    assert map_run(run, settings()).unchanged
    assert run.field_path.stat().st_mtime_ns == before
    assert not map_run(run, settings(), overwrite=True).unchanged
    assert not map_run(run, settings(seed=1)).unchanged


def test_default_sensors_are_all_but_the_ground_truth(make_mappable_run):
    run = make_mappable_run()
    map_run(run, settings("fusion.passes=0", "field.iterations=0"))
    assert run.load_manifest().stages["map"].facts["sensors"] == ["noisy"]


def test_held_out_frames_stay_out(make_mappable_run):
    run = make_mappable_run(("gt",))
    assert map_run(run, settings(hold_out=4)).frames == 9
    assert run.load_manifest().stages["map"].facts["held_out"] == [3, 7, 11]
    assert len(Trajectory.load(run.trajectory_path)) == 9
    assert not run.beta_path("gt", 3).exists()
    assert run.beta_path("gt", 4).exists()


def test_frames_without_pose_are_left_out_with_a_word(make_mappable_run):
    run = make_mappable_run(("gt",))
    strip_poses(run, [0, 5])
    events = []
    assert map_run(run, settings(), on_event=events.append).frames == 10
    assert any(isinstance(event, Warn) and "2 of 12 frames" in event.text for event in events)
    np.testing.assert_array_equal(Trajectory.load(run.trajectory_path).timestamps, [1, 2, 3, 4, *range(6, 12)])


def test_a_frame_kilometres_away_costs_no_memory_and_one_out_of_range_is_left_out(make_mappable_run):
    run = make_mappable_run(("gt",))
    records = json.loads(run.frames_path.read_text())
    records[5]["T_world_camera"][0][3] += 100_000.0
    records[7]["T_world_camera"][1][3] -= 1e9
    write_text(run.frames_path, json.dumps(records))
    events = []
    once = settings("fusion.passes=0", "field.iterations=0", "fusion.min_observations=1")
    summary = map_run(run, once, on_event=events.append)
    assert summary.frames == 11
    assert [event for event in events if isinstance(event, Warn) and "the first is frame 7" in event.text]
    blocks = load_field(run).grid.blocks
    assert int(blocks[:, 0].max()) > 100_000 / 0.4
    assert run.field_path.stat().st_size < 3e8
    mesh_run(run)
    assert Mesh.load(run.mesh_path).vertices[:, 0].max() > 99_990


def test_what_cannot_be_mapped_is_said(make_mappable_run):
    run = make_mappable_run(("gt",))
    with pytest.raises(ConfigError, match=r"no sensor called 'sl'.*gt"):
        map_run(run, settings(sensors=("sl",)))
    for method, overrides in (("uncle", ["fusion.max_depth_m=0.2"]), ("tsdf", ["fusion.max_depth_m=0.2"])):
        with pytest.raises(DataError):
            map_run(run, settings(*overrides, method=method))
        run.checkpoint_path.unlink(missing_ok=True)
    for method in ("uncle", "tsdf"):
        with pytest.raises(DataError, match="often enough"):
            map_run(run, settings("fusion.min_observations=99", method=method))
        run.checkpoint_path.unlink(missing_ok=True)
    strip_poses(run, list(range(12)))
    with pytest.raises(DataError, match="no camera poses"):
        map_run(run, settings())
    assert "map" not in run.load_manifest().stages
    with pytest.raises(RunError, match="uncle map"):
        load_field(run)


class Broken(Exception):
    """Stands for whatever ends a process."""


def break_at(stage: str, done: int):
    """A listener that ends the run at a given point."""

    def on_event(event) -> None:
        if isinstance(event, Progress) and event.stage.startswith(stage) and event.done == done:
            raise Broken

    return on_event


def results(run: RunDirectory) -> dict[str, bytes]:
    """Every file that says what the map is."""
    mesh_run(run, overwrite=True)
    paths = [run.mesh_path, run.trajectory_path, run.curves_path, *sorted((run.root / "beta").rglob("*.png"))]
    return {str(path.relative_to(run.root)): path.read_bytes() for path in paths}


@pytest.fixture
def frequent_checkpoints(monkeypatch):
    monkeypatch.setattr(map_stage, "Checkpoint", partial(Checkpoint, interval_s=0.0))


POINTS = [("mapping", 7), ("integrating", 5), ("refining", 8), ("writing beta", 6)]


def test_broken_run_resumes_to_the_same_bytes(make_mappable_run, frequent_checkpoints):
    run = make_mappable_run(("noisy",))
    map_run(run, settings())
    expected = results(run)
    assert len(expected) == 15
    for stage, done in POINTS:
        with pytest.raises(Broken):
            map_run(run, settings(), overwrite=True, on_event=break_at(stage, done))
        assert run.checkpoint_path.exists()
        events = []
        map_run(run, settings(), resume=True, on_event=events.append)
        assert any(isinstance(event, Note) and "continuing" in event.text for event in events), stage
        assert results(run) == expected, stage


def test_broken_run_remembers_what_was_wrong_with_a_sensor(make_mappable_run, frequent_checkpoints):
    run, config, events = make_mappable_run(), settings(sensors=("gt", "noisy")), []
    for index in range(5, 11):
        shutil.copy(run.depth_path("noisy", 4), run.depth_path("noisy", index))
    map_run(run, config, on_event=events.append)
    assert Warn("noisy: frozen from frame 5 to 10, left out") in events
    assert run.load_manifest().stages["map"].facts["faulty_frames"] == {"noisy": {"frozen": 6}}
    assert not RunFrames(run).beta(7, "noisy").any()
    expected = results(run) | {"sensors": run.sensors_path.read_bytes()}
    for stage, done in [("mapping", 7), ("integrating", 3)]:
        with pytest.raises(Broken):
            map_run(run, config, overwrite=True, on_event=break_at(stage, done))
        map_run(run, config, resume=True)
        assert results(run) | {"sensors": run.sensors_path.read_bytes()} == expected, stage


def test_a_broken_run_is_not_taken_for_a_finished_one(make_mappable_run):
    """A map that was begun over an older one and broke leaves no record of the older, whose files it has changed."""
    run = make_mappable_run(("noisy",))
    map_run(run, settings())
    with pytest.raises(Broken):
        map_run(run, settings(seed=1), on_event=break_at("writing beta", 6))
    with pytest.raises(RunError, match="`uncle map` has not finished writing; redo with"):
        load_field(run)
    assert not map_run(run, settings()).unchanged


def test_break_while_exploring_keeps_the_finished_map(make_mappable_run):
    run = make_mappable_run(("noisy",))
    map_run(run, settings())
    with pytest.raises(Broken):
        map_run(run, settings(seed=1), on_event=break_at("mapping", 4))
    assert map_run(run, settings()).unchanged
    load_field(run)


def test_resume_needs_the_same_settings(make_mappable_run, frequent_checkpoints):
    run = make_mappable_run(("noisy",))
    with pytest.raises(Broken):
        map_run(run, settings(), on_event=break_at("mapping", 3))
    with pytest.raises(RunError, match="other settings"):
        map_run(run, settings(seed=1), resume=True)
    events = []
    map_run(run, settings(), on_event=events.append)  # without --resume it starts over, and says so
    assert any(isinstance(event, Note) and "--resume" in event.text for event in events)
    assert not any(isinstance(event, Note) and "continuing" in event.text for event in events)


def test_resume_without_a_broken_run_is_a_run(make_mappable_run):
    assert map_run(make_mappable_run(("noisy",)), settings(), resume=True).frames == 12


# Ends its own process as a power cut would, just before the file number KILL is put in its place.
CHILD = """
import os, signal, sys
from functools import partial
from uncle.recon.stages import map as map_stage
replace, left = os.replace, int(os.environ["KILL"])
def counted(*paths):
    global left
    left -= 1
    if left == 0:
        os.kill(os.getpid(), signal.SIGKILL)
    replace(*paths)
os.replace = counted
map_stage.Checkpoint = partial(map_stage.Checkpoint, interval_s=0.0)
from uncle.cli.main import main
main(sys.argv[1:])
"""


def child(run: RunDirectory, kill: int, *arguments: str) -> int:
    overrides = [word for override in QUICK for word in ("--set", override)]
    command = [sys.executable, "-c", CHILD, "--quiet", "map", "--run", str(run.root), "--device", "cpu", *overrides]
    return subprocess.run([*command, *arguments], env=os.environ | {"KILL": str(kill)}, check=False).returncode


@pytest.mark.slow
@pytest.mark.parametrize("kill", [5, 13 + 4, 26 + 6])  # while exploring, in an integration pass, among the beta maps
def test_killed_run_resumes_to_the_same_bytes(make_mappable_run, kill):
    run = make_mappable_run(("noisy",))
    assert child(run, 0) == 0
    expected = results(run)
    assert child(run, kill, "--overwrite") == -signal.SIGKILL
    assert run.checkpoint_path.exists()
    assert child(run, 0, "--resume") == 0
    assert results(run) == expected


def test_memory_of_the_gpu_is_a_fact_where_one_was_used(monkeypatch):
    monkeypatch.setattr(map_stage.torch.cuda, "is_initialized", lambda: False)
    assert map_stage.gpu_memory() == {}
    monkeypatch.setattr(map_stage.torch.cuda, "is_initialized", lambda: True)
    monkeypatch.setattr(map_stage.torch.cuda, "max_memory_allocated", lambda: 1_234_560_000)
    assert map_stage.gpu_memory() == {"gpu_memory_mb": 1234.6}
