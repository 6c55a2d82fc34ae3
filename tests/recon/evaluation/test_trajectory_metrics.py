"""Trajectory errors: known motions, and evo as the oracle."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.recon.core.errors import DataError
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.evaluation.trajectory_metrics import (
    MatchedPoses,
    TrajectoryParameters,
    associate,
    evaluate_trajectory,
    has_clock,
    pairs_after,
    rigid_alignment,
)


def walk(count: int = 60, seed: int = 0, noise: float = 0.0) -> Trajectory:
    """A curved path at 10 Hz; `noise` in metres and radians per pose."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 4.0, count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    turn = Rotation.from_euler("zyx", np.column_stack([t, 0.3 * np.sin(t), 0.1 * t]))
    poses[:, :3, :3] = (turn * Rotation.from_rotvec(noise * rng.normal(size=(count, 3)))).as_matrix()
    poses[:, :3, 3] = np.column_stack([np.cos(t), np.sin(2 * t), 0.2 * t]) + noise * rng.normal(size=(count, 3))
    return Trajectory(0.1 * np.arange(count), poses)


def moved_by(trajectory: Trajectory, T: np.ndarray) -> Trajectory:
    return Trajectory(trajectory.timestamps, T @ trajectory.T_world_camera)


@pytest.fixture
def motion() -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.3, -0.5, 0.9]).as_matrix()
    T[:3, 3] = [1.0, -2.0, 0.5]
    return T


def test_alignment_removes_a_rigid_motion_and_nothing_else_does(motion):
    metrics = evaluate_trajectory(moved_by(walk(), motion), walk())
    assert metrics.ate_m.rmse > 0.5
    assert metrics.ate_aligned_m.max < 1e-9
    assert metrics.rpe_translation_m.max < 1e-9
    assert metrics.rpe_rotation_rad.max < 1e-7


def test_a_shift_is_reported_to_the_millimetre():
    shift = np.eye(4)
    shift[:3, 3] = [0.03, 0.0, 0.04]
    ate = evaluate_trajectory(moved_by(walk(), shift), walk()).ate_m
    assert (ate.rmse, ate.mean, ate.median, ate.max) == pytest.approx((0.05, 0.05, 0.05, 0.05))


def test_alignment_is_that_of_scipy_and_never_a_mirror(motion):
    source = np.random.default_rng(0).normal(size=(50, 3))
    target = source @ motion[:3, :3].T + motion[:3, 3] + 0.01 * np.random.default_rng(1).normal(size=(50, 3))
    T = rigid_alignment(source, target)
    oracle, _ = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))
    np.testing.assert_allclose(T[:3, :3], oracle.as_matrix(), atol=1e-9)
    mirrored = rigid_alignment(source, source * [-1, 1, 1])
    assert np.linalg.det(mirrored[:3, :3]) == pytest.approx(1.0)
    flat = rigid_alignment(source * [1, 1, 0], source * [1, 1, 0])
    np.testing.assert_allclose(flat, np.eye(4), atol=1e-9)


def test_agrees_with_evo(motion):
    metrics = pytest.importorskip("evo.core.metrics")
    paths = pytest.importorskip("evo.core.trajectory")
    estimate, truth = moved_by(walk(noise=0.02), motion), walk()
    as_evo = [
        paths.PoseTrajectory3D(poses_se3=list(t.T_world_camera), timestamps=t.timestamps) for t in (truth, estimate)
    ]
    ours = evaluate_trajectory(estimate, truth)
    relation = metrics.PoseRelation
    expected = {
        "ate_m": _evo(metrics.APE(relation.translation_part), as_evo),
        "rpe_translation_m": _evo(metrics.RPE(relation.translation_part, 1, metrics.Unit.frames), as_evo),
        "rpe_rotation_rad": _evo(metrics.RPE(relation.rotation_angle_rad, 1, metrics.Unit.frames), as_evo),
    }
    for name, part in (("translation_m", relation.translation_part), ("rotation_rad", relation.rotation_angle_rad)):
        ten_frames = metrics.RPE(part, 10, metrics.Unit.frames, all_pairs=True)  # one second at 10 Hz
        expected[f"rpe_second_{name}"] = _evo(ten_frames, as_evo)
    as_evo[1].align(as_evo[0], correct_scale=False)
    expected["ate_aligned_m"] = _evo(metrics.APE(relation.translation_part), as_evo)
    for name, values in expected.items():
        found = getattr(ours, name)
        for statistic in ("rmse", "mean", "median", "max"):
            assert getattr(found, statistic) == pytest.approx(values[statistic], rel=1e-6), (name, statistic)


def _evo(metric, pair) -> dict[str, float]:
    metric.process_data(tuple(pair))
    return metric.get_all_statistics()


def test_agrees_with_evo_on_written_files_with_gaps(motion, tmp_path):
    """As `evo_ape tum` and `evo_rpe tum` read and match them: estimate with lost frames, truth at another rate."""
    metrics = pytest.importorskip("evo.core.metrics")
    files = pytest.importorskip("evo.tools.file_interface")
    sync = pytest.importorskip("evo.core.sync")
    true = walk(240)
    true = Trajectory(1.3e9 + 0.025 * np.arange(240), true.T_world_camera)
    kept = np.r_[0:30, 42:80]
    noisy = moved_by(walk(240, noise=0.01), motion).T_world_camera[::3]
    estimate = Trajectory(true.timestamps[::3][kept] + 0.004, noisy[kept])
    true.save(tmp_path / "groundtruth.txt")
    estimate.save(tmp_path / "trajectory.txt")
    read = [files.read_tum_trajectory_file(str(tmp_path / f"{name}.txt")) for name in ("groundtruth", "trajectory")]
    pair = sync.associate_trajectories(*read, max_diff=0.01)
    ours = evaluate_trajectory(*(Trajectory.load(tmp_path / f"{name}.txt") for name in ("trajectory", "groundtruth")))
    assert ours.matched_poses == pair[0].num_poses == len(kept)
    translation = metrics.PoseRelation.translation_part
    relative = _evo(metrics.RPE(translation, 1, metrics.Unit.frames), pair)
    assert ours.ate_m.rmse == pytest.approx(_evo(metrics.APE(translation), pair)["rmse"], rel=1e-5)
    assert ours.rpe_translation_m.rmse == pytest.approx(relative["rmse"], rel=1e-5)
    pair[1].align(pair[0], correct_scale=False)
    assert ours.ate_aligned_m.rmse == pytest.approx(_evo(metrics.APE(translation), pair)["rmse"], rel=1e-5)


def test_pairs_after_a_second_leave_gaps_and_ends_out():
    stamps = np.array([0.0, 0.1, 0.2, 1.0, 1.11, 1.31, 2.9])
    starts, ends = pairs_after(stamps, 1.0)
    np.testing.assert_array_equal(starts, [0, 1])
    np.testing.assert_array_equal(ends, [3, 4])
    assert len(pairs_after(np.zeros(1), 1.0)[0]) == 0
    assert len(pairs_after(np.array([0.0, 5.0]), 1.0)[0]) == 0


def test_without_a_clock_nothing_is_said_per_second():
    frames = Trajectory(np.arange(60.0), walk().T_world_camera)
    metrics = evaluate_trajectory(frames, frames)
    assert not has_clock(frames.timestamps)
    assert has_clock(walk().timestamps)
    assert metrics.rpe_second_translation_m is None
    assert metrics.drift.growth_m_per_s is None
    assert metrics.drift.growth_ratio == 0.0


def test_rotation_errors_need_no_positions(motion):
    """A camera that only turns: positions leave its orientation open, its orientations do not."""
    still = walk()
    still.T_world_camera[:, :3, 3] = 1.0
    matched = MatchedPoses.of(moved_by(still, motion), still)
    angle = np.linalg.norm([0.3, -0.5, 0.9])
    np.testing.assert_allclose(matched.rotation_errors(aligned=False), angle, atol=1e-9)
    np.testing.assert_allclose(matched.rotation_errors(aligned=True), 0.0, atol=1e-7)


def test_files_out_of_order_are_scored_in_the_order_of_time():
    order = np.random.default_rng(0).permutation(60)
    shuffled = Trajectory(walk().timestamps[order], walk(noise=0.01).T_world_camera[order])
    assert evaluate_trajectory(shuffled, walk()) == evaluate_trajectory(walk(noise=0.01), walk())


def test_one_pose_has_a_distance_and_no_motion():
    metrics = evaluate_trajectory(Trajectory(np.array([0.5]), np.eye(4)[None]), walk())
    assert metrics.matched_poses == 1
    assert metrics.ate_m.rmse == pytest.approx(np.linalg.norm(walk().T_world_camera[5, :3, 3]))
    assert metrics.ate_aligned_m.rmse == pytest.approx(0.0, abs=1e-12)
    assert (metrics.rpe_translation_m, metrics.rpe_second_rotation_rad, metrics.drift) == (None, None, None)


def test_association_takes_the_nearest_once_and_leaves_the_far():
    poses = np.tile(np.eye(4), (4, 1, 1))
    estimate = Trajectory(np.array([0.0, 0.011, 1.0, 5.0]), poses)
    reference = Trajectory(np.array([0.01, 0.985, 2.0, 3.0]), poses)
    np.testing.assert_array_equal(associate(estimate, reference, 0.02), [[1, 0], [2, 1]])


def test_poses_that_are_not_finite_are_left_out():
    broken = walk()
    broken.T_world_camera[3] = np.nan
    metrics = evaluate_trajectory(walk(), broken)
    assert (metrics.matched_poses, metrics.reference_poses) == (59, 60)
    assert metrics.ate_m.max == 0.0


def test_relative_errors_over_several_frames(motion):
    drift = walk()
    for index in range(len(drift)):
        drift.T_world_camera[index, 2, 3] += 0.01 * index
    metrics = evaluate_trajectory(drift, walk(), TrajectoryParameters(rpe_delta_frames=5))
    translation, rotation = metrics.rpe_translation_m, metrics.rpe_rotation_rad
    for statistic in ("mean", "median", "max"):
        assert getattr(translation, statistic) == pytest.approx(0.05, abs=1e-9)
    assert rotation.max == pytest.approx(0.0, abs=1e-7)
    assert metrics.rpe_delta_frames == 5
    assert evaluate_trajectory(walk(1), walk(1)).rpe_translation_m is None


def test_no_common_time_is_an_error_that_names_both():
    late = Trajectory(walk().timestamps + 1000.0, walk().T_world_camera)
    with pytest.raises(DataError, match=r"share no time stamp.*1000\.000"):
        evaluate_trajectory(late, walk())


def test_poses_without_a_usable_time_stamp_are_left_out():
    poses = np.tile(np.eye(4), (4, 1, 1))
    estimate = Trajectory(np.array([0.0, np.nan, np.inf, 1e300]), poses)
    np.testing.assert_array_equal(associate(estimate, Trajectory(np.arange(4.0), poses), 0.02), [[0, 0]])


def test_no_finite_pose_is_an_error():
    broken = Trajectory(walk().timestamps, np.full((60, 4, 4), np.nan))
    with pytest.raises(DataError, match="no finite pose"):
        evaluate_trajectory(broken, walk())
