"""The sums behind the benchmark tables, and Open3D's dense SLAM on a made room."""

import importlib
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from uncle.datasets import senfunet, seven_scenes
from uncle.datasets.synth.write import SynthOptions, make_dataset
from uncle.recon.core.errors import RunError
from uncle.recon.core.frame import Frame
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.evaluation.bench.scores import UNCERTAINTY
from uncle.recon.run.tracking_record import TrackedFrame, TrackingRecord

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # the programs import each other by their bare names
common, chain, tracking, open3d_slam = map(importlib.import_module, ("common", "chain", "tracking", "open3d_slam"))


def record(method="uncle", seed=0, wall_s=1.0, session="a", hold_out=0, **scores):
    job = chain.Job("room", "sl", method, seed, hold_out)
    return {**job._asdict(), "wall_s": wall_s, "session": session, **scores}


@pytest.mark.parametrize(("seeds", "order"), [(1, "tu t t"), (3, "tu tu tu"), (5, "tu tu tu u u")])
def test_baseline_is_timed_three_times_in_turns(seeds, order):
    jobs = chain.plan("room", ["sl"], ["tsdf", "uncle"], seeds, 0)
    assert "".join(job.method[0] for job in jobs) == order.replace(" ", "")
    assert [job.seed for job in jobs if job.method == "uncle"] == list(range(seeds))
    assert len({job.key for job in jobs}) == len(jobs)


def test_keys_tell_sensors_and_held_out_frames_apart():
    jobs = chain.plan("room", ["sl", "sl+sgm"], ["uncle"], 1, 0) + chain.plan("room", ["sl"], ["uncle"], 1, 10)
    assert len({job.key for job in jobs}) == 3


def test_markdown_has_a_row_per_method_and_leaves_empty_columns_out():
    sensor = dict.fromkeys(UNCERTAINTY, 0.25)
    baseline = [record("tsdf", seed, wall_s=2.0, **({"f_score_5cm": 0.8} if seed == 0 else {})) for seed in range(3)]
    ours = [record(seed=seed, wall_s=5.0, f_score_5cm=0.9, uncertainty={"sl": sensor}) for seed in range(2)]
    scene, sensors = chain.markdown(baseline + ours).split("\n\n")
    assert scene.splitlines() == [
        "| data set | sensors | method | runs | F 5 cm % | map s | time / tsdf |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| room | sl | tsdf | 3 | 80.00 | 2.0 | 1.00 |",
        "| room | sl | uncle | 2 | 90.00 [90.00, 90.00] | 5.0 | 2.50 |",
    ]
    assert sensors.splitlines()[2] == (
        "| room | sl | uncle | sl | 2 | 0.250 [0.250, 0.250] | 0.250 | 0.250 "
        "| 25.0 | 25.0 | 25.0 | 25.0 | 0.250 | 25.0 |"
    )
    assert len(sensors.splitlines()) == 3


# --- results that survive an interruption ----------------------------------------------------------------------------
def test_what_is_done_is_kept_and_what_failed_is_tried_again(tmp_path):
    jobs, path, calls = chain.plan("room", ["sl"], ["uncle"], 3, 0), tmp_path / "results.json", []

    def execute(job):
        calls.append(job.seed)
        if len(calls) == 2:
            raise RunError("no surface")
        return {"seed": job.seed}

    def is_done(job, record):
        return job.seed != 2 or len(calls) > 4

    records, failed = common.carry_out(jobs, path, execute, is_done)
    assert failed == {jobs[1].key: "no surface"}
    assert set(records) == {jobs[0].key, jobs[2].key} == set(json.loads(path.read_text()))
    records, failed = common.carry_out(jobs, path, execute, is_done)
    assert (calls, failed, len(records)) == ([0, 1, 2, 1, 2], {}, 3)  # a record that says too little is made again
    assert common.carry_out(jobs, path, execute, is_done)[0] == json.loads(path.read_text())
    assert len(calls) == 5


# --- tracking --------------------------------------------------------------------------------------------------------
def tracked(system="uncle", seed=0, ate_m=0.01, session="a", frames_per_s=2.0, voxel_m=0.0, **more):
    job = tracking.Job("room", "0:9", "sl", system, voxel_m, seed)
    costs = {"wall_s": 10.0, "seconds": {"tracking": 2.0, "pass_1": 3.0, "pass_2": 1.0}, "session": session}
    costs |= {"frames_per_s": frames_per_s, "loop_frames_per_s": 2 * frames_per_s, "used_voxel_m": voxel_m or 0.02}
    return job._asdict() | costs | {"ate_m": ate_m} | more


def test_systems_take_turns_and_open3d_has_every_voxel_size():
    jobs = tracking.plan("room", "", ["sl"], ["uncle", "open3d", "given"], [0.01, 0.02], 5)
    turns = [[(job.system, job.voxel_m) for job in jobs if job.seed == seed] for seed in range(5)]
    every = [("uncle", 0.0), ("open3d", 0.01), ("open3d", 0.02), ("given", 0.0)]
    assert turns == [every] * tracking.REPETITIONS + [[("uncle", 0.0)]] * 2
    assert len({job.key for job in jobs}) == len(jobs)


def test_errors_are_those_of_the_frames_that_have_a_pose(tmp_path):
    true = np.tile(np.eye(4), (5, 1, 1))
    true[:, 0, 3] = np.arange(5) * 0.1
    moved = true.copy()
    moved[:, 1, 3] += 0.03
    Trajectory(np.arange(5.0), true).save(tmp_path / "trajectory_gt.txt")
    assert tracking.errors(tmp_path, 5) == {"posed": 0.0}
    Trajectory(np.arange(5.0)[:4], moved[:4]).save(tmp_path / "trajectory.txt")
    states = ["tracked", "weak", "relocalised", "tracked", "lost"]
    frames = (TrackedFrame(index=i, timestamp=i, status=state) for i, state in enumerate(states))
    TrackingRecord(frames=tuple(frames)).save(tmp_path / "tracking.json")
    found = tracking.errors(tmp_path, 5)
    assert found.pop("ate_m") == pytest.approx(0.03)
    assert [found.pop(key) for key in ("tracked", "weak", "lost")] == [3, 1, 1]
    assert found.pop("posed") == 0.8
    assert all(abs(value) < 1e-6 for value in found.values())
    assert set(found) == {"ate_aligned_m", "rpe_translation_m", "rpe_rotation_rad", "rpe_max_m"}


def test_colour_camera_of_7_scenes_is_compared_with_structure_from_motion(tmp_path):
    rng = np.random.default_rng(0)
    depth_camera = np.tile(np.eye(4), (9, 1, 1))
    depth_camera[:, :3, :3] = Rotation.from_rotvec(rng.normal(0, 0.5, (9, 3))).as_matrix()
    depth_camera[:, :3, 3] = rng.normal(0, 1, (9, 3))
    color_camera = depth_camera @ np.linalg.inv(seven_scenes.T_COLOR_DEPTH)
    world = np.eye(4)  # that of structure from motion is another one
    world[:3, :3], world[:3, 3] = Rotation.from_rotvec([0.3, -0.2, 1.0]).as_matrix(), [3.0, 1.0, -2.0]
    camera_world = np.linalg.inv(world @ color_camera)
    x, y, z, w = Rotation.from_matrix(camera_world[:, :3, :3]).as_quat().T
    np.savetxt(tmp_path / "sfm.txt", np.column_stack([np.arange(9), w, x, y, z, camera_world[:, :3, 3], [525.5] * 9]))
    estimate = Trajectory(np.arange(1.0, 8.0), depth_camera[1:8])
    assert tracking.error_to_sfm(estimate, tmp_path / "sfm.txt") < 1e-9
    estimate.T_world_camera[3, 0, 3] += 0.07
    assert 0.01 < tracking.error_to_sfm(estimate, tmp_path / "sfm.txt") < 0.07 / 7**0.5  # the alignment takes a part


def test_worst_is_the_largest_over_the_median():
    records = [tracked(ate_m=ate_m) for ate_m in (0.01, 0.03, 0.02)] + [tracked(ate_m=None)]
    assert tracking.worst(records, "ate_m") == "1.50"
    assert tracking.worst(records[:1], "ate_m") == "-"
    assert tracking.worst([tracked(ate_m=1e-9), tracked(ate_m=2e-9)], "ate_m") == "-"  # given poses


def test_shares_are_of_the_whole_process_and_sweeps_are_mapping():
    assert tracking.shares([tracked()]) == "tracking 20, mapping 40, rest 40"


def test_table_of_systems_compares_speed_with_the_first_open3d():
    records = [tracked("open3d", voxel_m=voxel, frames_per_s=rate) for voxel, rate in ((0.01, 4.0), (0.02, 8.0))]
    records += [tracked(seed=seed, ate_m=ate_m, lost=seed) for seed, ate_m in enumerate((0.01, 0.02, 0.04))]
    rows = [line.strip("| ").split(" | ") for line in tracking.markdown(records).splitlines()]
    by_heading = [dict(zip(rows[0], row, strict=True)) for row in rows[2:]]
    assert [row["system"] + row["voxel cm"] for row in by_heading] == ["open3d1", "open3d2", "uncle2"]
    assert [row["speed / open3d"] for row in by_heading] == ["1.00", "2.00", "0.50"]
    assert by_heading[2]["ATE as it is cm"] == "2.00 [1.00, 4.00]"
    assert by_heading[2]["worst / median"] == "2.00"
    assert by_heading[2]["lost"] == "1 [0, 2]"
    assert "F 5 cm %" not in rows[0]


class Frames:
    """Frames in memory, in the place of those of a run."""

    def __init__(self, recording, without_depth):
        self.frames, self.camera = [recording[i] for i in range(len(recording))], recording.camera
        for i in without_depth:
            frame, nothing = self.frames[i], {name: torch.zeros_like(d) for name, d in self.frames[i].depths.items()}
            self.frames[i] = Frame(i, frame.timestamp, frame.color, nothing, frame.T_world_camera)

    def __len__(self):
        return len(self.frames)

    def pose(self, index):
        return self.frames[index].T_world_camera

    def stream(self, indices, prepare):
        return (prepare(self.frames[i]) for i in indices)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    out = tmp_path_factory.mktemp("slam") / "room"
    return senfunet.read(make_dataset(out, SynthOptions(frames=6, size_px=256, seed=1, sensors=())))


@pytest.mark.parametrize(
    ("method", "without_depth"), [("open3d-hybrid", ()), *(("open3d", lost) for lost in ((), (3,), (0, 1), range(6)))]
)
def test_open3d_starts_at_the_given_pose_and_outlives_frames_without_depth(room, method, without_depth):
    frames = Frames(room, without_depth)
    out = open3d_slam.slam(frames, method, 0.01)
    assert out.lost == list(without_depth)
    np.testing.assert_allclose(out.poses[0], frames.pose(0))
    if without_depth == (3,):
        np.testing.assert_allclose(out.poses[3], out.poses[2])
    if 0 not in without_depth:
        off, moved = (np.linalg.norm(frames.pose(5)[:3, 3] - pose[:3, 3]) for pose in (out.poses[5], frames.pose(0)))
        assert off < 0.35 * moved


def test_open3d_gets_the_mean_of_the_readings_there_are():
    depths = {"sl": torch.tensor([[1.0, 2.0, 0.0]]), "sgm": torch.tensor([[3.0, 0.0, 0.0]])}
    depth, color = open3d_slam.images_of(Frame(0, 0.0, torch.zeros(1, 3, 3, dtype=torch.uint8), depths, None))
    assert depth.as_tensor().numpy()[..., 0].tolist() == [[2000, 2000, 0]]
    assert color.as_tensor().numpy().dtype == np.uint8
