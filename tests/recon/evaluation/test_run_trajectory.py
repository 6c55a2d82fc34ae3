"""The camera of a run: what is scored and shown of it, with and without truth and tracking record."""

import time

import numpy as np
import pytest
from uncle.recon.core.errors import DataError, RunError
from uncle.recon.core.json_values import to_plain
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.evaluation.run_metrics import score_run
from uncle.recon.evaluation.run_trajectory import score_tracking, score_trajectory
from uncle.recon.evaluation.surface_metrics import EvaluationSettings
from uncle.recon.run.tracking_record import TrackedFrame, TrackingRecord
from uncle.recon.visualization.report_camera import camera_section

LOST = (4, 5, 9)


@pytest.fixture
def tracked_run(make_box_run):
    """12 frames, 3 of them lost, the others 3 cm off and said to be so."""
    run = make_box_run()
    true = Trajectory.load(run.reference_trajectory_path)
    kept = [index for index in range(12) if index not in LOST]
    poses = true.T_world_camera[kept].copy()
    poses[:, 2, 3] += 0.03
    Trajectory(true.timestamps[kept], poses).save(run.trajectory_path)
    frames = [
        TrackedFrame(index=i, timestamp=i, status="lost" if i in LOST else "tracked",
                     covariance=None if i in LOST else (0.03**2 * np.eye(6)).tolist())
        for i in range(12)
    ]  # fmt: skip
    TrackingRecord(frames=tuple(frames)).save(run.tracking_path)
    run.finish_stage("map", "0", time.time(), {"held_out": []})
    return run


def test_a_tracked_run_is_scored(tracked_run):
    metrics = score_run(tracked_run, EvaluationSettings(views=0))
    assert metrics.trajectory.completeness == 0.75
    assert metrics.trajectory.ate_m.rmse == pytest.approx(0.03, abs=1e-6)
    assert metrics.tracking.statuses["lost"].frames == 3
    assert metrics.tracking.since_start.poses == 8
    assert "tracking" not in metrics.skipped
    stored = to_plain(metrics)["tracking"]
    assert stored["lost_ranges"] == [[4, 5], [9, 9]]
    assert stored["statuses"]["tracked"] == {"frames": 9, "ratio": 0.75}


def test_given_poses_have_no_tracking_and_no_reason_why(tracked_run):
    tracked_run.tracking_path.unlink()
    metrics = score_run(tracked_run, EvaluationSettings(views=0))
    assert metrics.tracking is None
    assert "tracking" not in metrics.skipped


def test_a_tracker_without_error_is_not_taken_for_given_poses(tracked_run):
    tracked_run.trajectory_path.write_bytes(tracked_run.reference_trajectory_path.read_bytes())
    assert score_run(tracked_run, EvaluationSettings(views=0)).notes == ()


def test_held_out_frames_without_a_pose_are_not_missed(tracked_run):
    tracked_run.finish_stage("map", "0", time.time(), {"held_out": [4, 6, 99]})
    assert score_trajectory(tracked_run).completeness == pytest.approx(9 / 11)  # 4 has no pose, 6 has one


def test_without_truth_the_tracker_is_still_counted(tracked_run):
    tracked_run.reference_trajectory_path.unlink()
    metrics = score_run(tracked_run, EvaluationSettings(views=0))
    assert metrics.trajectory is None
    assert metrics.tracking.statuses["tracked"].frames == 9
    assert metrics.tracking.since_start is None
    section = camera_section(tracked_run)
    assert section.count("<img") == 2
    assert "no ground-truth poses" in section


def test_everything_lost(tracked_run):
    frames = tuple(TrackedFrame(index=i, timestamp=i, status="lost") for i in range(12))
    TrackingRecord(frames=frames).save(tracked_run.tracking_path)
    for leave in ("# timestamp tx ty tz qx qy qz qw\n", None):
        if leave is None:
            tracked_run.trajectory_path.unlink()
        else:
            tracked_run.trajectory_path.write_text(leave)
        assert score_tracking(tracked_run).lost_ranges == ((0, 11),)
        section = camera_section(tracked_run)
        assert "12 of 12 frames were lost: 0 to 11." in section
        assert "Not drawn" in section


def test_a_broken_record_costs_its_part_only(tracked_run):
    tracked_run.tracking_path.write_text('{"frames": [{"index": 0}]}')
    metrics = score_run(tracked_run, EvaluationSettings(views=0))
    assert metrics.tracking is None
    assert metrics.trajectory.completeness == 0.75
    assert "tracking.json" in metrics.skipped["tracking"]
    assert "\n" not in metrics.skipped["tracking"]
    with pytest.raises(DataError, match="uncle map --track"):
        camera_section(tracked_run)


def test_section_shows_figures_charts_and_losses(tracked_run):
    section = camera_section(tracked_run)
    assert "3 of 12 frames were lost: 4 to 5, 9." in section
    assert section.count("<img") == 2
    for text in ("ATE (aligned)", "3.00 / 3.00 / 3.00 / 3.00", "75.00", "frames lost", "true / predicted sigma"):
        assert text in section
    assert (tracked_run.snapshots_path / "trajectory.png").is_file()
    assert (tracked_run.snapshots_path / "drift.png").is_file()


def test_no_trajectory_names_the_command(make_box_run):
    run = make_box_run()
    assert f"uncle map --run {run.root}" in camera_section(run)
    assert score_tracking(run) is None
    with pytest.raises(DataError, match="no trajectory"):
        score_trajectory(run)
    run.frames_path.unlink()
    run.trajectory_path.write_bytes(run.reference_trajectory_path.read_bytes())
    with pytest.raises(RunError, match="uncle preprocess"):
        score_trajectory(run)
