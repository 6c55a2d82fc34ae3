"""What is counted of a tracker, and when its covariances are honest."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.evaluation.tracking_metrics import (
    describe_lost,
    evaluate_tracking,
    normalised_errors,
    pose_covariances,
    predicted_sigmas,
    rows_at,
)
from uncle.recon.evaluation.trajectory_metrics import MatchedPoses
from uncle.recon.run.tracking_record import TrackedFrame, TrackingRecord

SIGMAS = np.array([0.01, 0.02, 0.03, 0.004, 0.005, 0.006])


def exponential(x: np.ndarray) -> np.ndarray:
    """(N, 6) -> (N, 4, 4), first order in the mix of translation and rotation."""
    T = np.tile(np.eye(4), (len(x), 1, 1))
    T[:, :3, :3], T[:, :3, 3] = Rotation.from_rotvec(x[:, 3:]).as_matrix(), x[:, :3]
    return T


def tracked(count: int = 2000, factor: float = 1.0, stated: float = 1.0, seed: int = 0):
    """Errors of `factor` sigmas under covariances of `stated` sigmas; the first pose is exact."""
    rng = np.random.default_rng(seed)
    true = exponential(rng.normal(size=(count, 6)))
    errors = factor * SIGMAS * rng.normal(size=(count, 6))
    errors[0] = 0
    times = 0.1 * np.arange(count)
    covariance = np.tile(np.diag((stated * SIGMAS) ** 2), (count, 1, 1))
    covariance[0] = 0
    frames = tuple(
        TrackedFrame(index=i, timestamp=times[i], status="tracked", covariance=covariance[i].tolist())
        for i in range(count)
    )
    return TrackingRecord(frames=frames), MatchedPoses(times, true @ exponential(errors), true)


@pytest.mark.parametrize("which", ["since_start", "between_frames"])
def test_honest_covariances(which):
    found = getattr(evaluate_tracking(*tracked()), which)
    assert found.poses == 1999
    assert found.anees == pytest.approx(1.0, abs=0.06)
    assert found.sigma_factor == pytest.approx(1.0, abs=0.04)
    assert found.coverage_50 == pytest.approx(0.5, abs=0.04)
    assert found.coverage_90 == pytest.approx(0.9, abs=0.03)


def test_sigmas_three_times_too_small_are_named():
    found = evaluate_tracking(*tracked(stated=1 / 3)).since_start
    assert found.sigma_factor == pytest.approx(3.0, rel=0.04)
    assert found.anees == pytest.approx(9.0, rel=0.06)
    assert found.coverage_90 < 0.35


def test_drift_shows_since_the_start_and_not_between_frames():
    record, matched = tracked()
    drift = np.zeros((len(matched), 6))
    drift[:, 0] = 1e-4 * np.arange(len(matched))  # up to 20 sigmas of the map as a whole
    moved = MatchedPoses(matched.timestamps, exponential(drift) @ matched.estimate, matched.true)
    metrics = evaluate_tracking(record, moved)
    assert metrics.since_start.sigma_factor > 2
    assert metrics.between_frames.sigma_factor == pytest.approx(1.0, abs=0.05)


def test_normalised_error_by_hand():
    """A step of 2 m; the start may turn about z by 0.1 rad, so the end may be 0.2 m aside."""
    true = np.tile(np.eye(4), (2, 1, 1))
    true[1, 0, 3] = 2.0
    found = true.copy()
    found[1, 1, 3] = 0.1
    covariances = np.stack([np.diag([0, 0, 0, 0, 0, 0.1**2]), np.diag([1.0, 0.3**2, 1, 1, 1, 1])])
    (value,) = normalised_errors(found, true, covariances, np.array([0]), np.array([1]))
    y_variance, turn_variance, both = 0.3**2 + 0.2**2, 1 + 0.1**2, 0.2 * 0.1
    expected = 0.1**2 * turn_variance / (y_variance * turn_variance - both**2)
    assert value == pytest.approx(expected)


def test_covariances_that_say_nothing_are_left_out():
    true = np.tile(np.eye(4), (4, 1, 1))
    covariances = np.stack([np.zeros((6, 6)), np.full((6, 6), np.nan), -np.eye(6), np.eye(6)])
    found = normalised_errors(true, true, covariances, np.zeros(4, int), np.arange(4))
    np.testing.assert_array_equal(np.isfinite(found), [False, False, False, True])
    frames = [
        TrackedFrame(index=0, timestamp=0.0, status="tracked", covariance=[[1.0]]),
        TrackedFrame(index=1, timestamp=0.1, status="tracked"),
    ]
    record = TrackingRecord(frames=tuple(frames))
    metrics = evaluate_tracking(record, MatchedPoses(np.array([0.0, 0.1]), true[:2], true[:2]))
    assert (metrics.since_start, metrics.between_frames) == (None, None)


def test_statuses_and_lost_stretches_are_counted():
    statuses = ["tracked"] * 5 + ["lost"] * 2 + ["relocalised", "weak", "lost"]
    record = TrackingRecord(
        frames=tuple(TrackedFrame(index=10 + i, timestamp=float(i), status=s) for i, s in enumerate(statuses))
    )
    metrics = evaluate_tracking(record, None)
    assert {name: share.frames for name, share in metrics.statuses.items()} == {
        "tracked": 5, "weak": 1, "lost": 3, "relocalised": 1,
    }  # fmt: skip
    assert metrics.statuses["tracked"].ratio == 0.5
    assert metrics.lost_ranges == ((15, 16), (19, 19))
    assert metrics.since_start is None
    assert describe_lost(metrics) == "3 of 10 frames were lost: 15 to 16, 19."


def test_few_words_about_many_losses_and_about_none():
    frames = tuple(TrackedFrame(index=i, timestamp=i, status="lost" if i % 2 else "tracked") for i in range(40))
    text = describe_lost(evaluate_tracking(TrackingRecord(frames=frames), None))
    assert text.startswith("20 of 40 frames were lost: 1, 3, 5")
    assert text.endswith("15 and 12 more ranges.")
    assert describe_lost(evaluate_tracking(TrackingRecord(frames=frames[:1]), None)) == "No frame of 1 was lost."
    assert evaluate_tracking(TrackingRecord(frames=()), None).statuses["lost"].ratio == 0.0


def test_frames_are_found_by_time_even_at_epoch_and_out_of_order():
    times = 1.3e9 + np.array([0.2, 0.0, 0.1])
    wanted = Trajectory(np.round(1.3e9 + np.array([0.0, 0.1, 0.15]), 6), np.zeros((3, 4, 4))).timestamps
    np.testing.assert_array_equal(rows_at(times, wanted), [1, 2, -1])
    np.testing.assert_array_equal(rows_at(np.zeros(0), wanted), [-1, -1, -1])


def test_sigmas_are_of_the_whole_vector():
    record, matched = tracked(3)
    position, rotation = predicted_sigmas(pose_covariances(record, np.append(matched.timestamps, 9.0)))
    np.testing.assert_allclose(position[1:3], np.linalg.norm(SIGMAS[:3]))
    np.testing.assert_allclose(rotation[1:3], np.linalg.norm(SIGMAS[3:]))
    assert np.isnan(position[3])
