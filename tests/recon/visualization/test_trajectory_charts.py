"""Charts of the camera: what is drawn is looked up in the figure, before it becomes pixels."""

import cv2
import numpy as np
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.evaluation.trajectory_pair import CameraPath
from uncle.recon.run.tracking_record import TrackedFrame, TrackingRecord
from uncle.recon.visualization import trajectory_charts
from uncle.recon.visualization.trajectory_charts import draw_camera_path, drift_chart, trajectory_chart

TIMES = 100.0 + 0.5 * np.arange(20)
STATUSES = ["tracked"] * 6 + ["lost"] * 3 + ["relocalised", "weak"] + ["tracked"] * 9


@pytest.fixture
def true() -> Trajectory:
    """4 m along z, 2 m along x, 0.5 m along y."""
    poses = np.tile(np.eye(4), (20, 1, 1))
    way = np.linspace(0, 1, 20)
    poses[:, :3, 3] = np.column_stack([2 * way**2, 0.5 * np.sin(9 * way), 4 * way])
    return Trajectory(TIMES, poses)


@pytest.fixture
def record() -> TrackingRecord:
    covariance = np.diag([0.01**2] * 3 + [0.02**2] * 3)
    frames = []
    for index, status in enumerate(STATUSES):
        stated = None if status == "lost" else covariance.tolist()
        frames.append(TrackedFrame(index=index, timestamp=TIMES[index], status=status, covariance=stated))
    return TrackingRecord(frames=tuple(frames))


@pytest.fixture
def estimate(true) -> Trajectory:
    """The truth moved by 3 cm along y, without the lost frames."""
    kept = np.array(STATUSES) != "lost"
    poses = true.T_world_camera[kept].copy()
    poses[:, 1, 3] += 0.03
    return Trajectory(TIMES[kept], poses)


@pytest.fixture
def figures(monkeypatch) -> list:
    """The figures that were encoded, in order."""
    kept = []
    encode = trajectory_charts.encode_figure
    monkeypatch.setattr(trajectory_charts, "encode_figure", lambda figure: kept.append(figure) or encode(figure))
    return kept


def lines(axes) -> dict:
    return {line.get_label(): line for line in axes.lines}


def test_the_way_is_drawn_aligned_in_the_plane_of_its_largest_extent(estimate, true, record, figures):
    trajectory_chart(CameraPath(estimate, true, record))
    top, side = figures[0].axes
    assert (top.get_xlabel(), top.get_ylabel(), side.get_ylabel()) == ("z [m]", "x [m]", "y [m]")
    assert all(axes.get_aspect() == 1.0 for axes in (top, side))
    drawn = lines(top)
    assert set(drawn) == {"true", "estimated, aligned", "lost", "relocalised (1)", "weak (1)", "start"}
    aligned = lines(side)["estimated, aligned"].get_ydata()
    assert np.isnan(aligned[6])  # the line stops where the camera was lost
    np.testing.assert_allclose(np.delete(aligned, 6), true.T_world_camera[np.array(STATUSES) != "lost", 1, 3],
                               atol=1e-9)  # fmt: skip
    np.testing.assert_allclose(drawn["weak (1)"].get_xdata(), true.T_world_camera[10, 2, 3], atol=1e-9)
    np.testing.assert_allclose(drawn["start"].get_xdata(), 0.0, atol=1e-9)
    lost = drawn["lost"].get_xdata()
    np.testing.assert_allclose(lost[np.isfinite(lost)], true.T_world_camera[5:10, 2, 3])


def test_without_truth_the_estimate_stays_where_it_is(estimate, record, figures):
    path = CameraPath(estimate, None, record)
    trajectory_chart(path)
    drawn = lines(figures[0].axes[1])
    assert "true" not in drawn
    np.testing.assert_allclose(np.delete(drawn["estimated"].get_ydata(), 6), estimate.T_world_camera[:, 1, 3])
    drift_chart(path)
    position, rotation = figures[1].axes
    sigma = np.delete(lines(position)["1 sigma, predicted by the tracker"].get_ydata(), 6)
    np.testing.assert_allclose(sigma, np.sqrt(3) * 1.0)  # cm
    sigma = np.delete(lines(rotation)["1 sigma, predicted by the tracker"].get_ydata(), 6)
    np.testing.assert_allclose(sigma, np.degrees(np.sqrt(3) * 0.02))


def test_drift_shows_errors_sigma_and_lost_stretches(estimate, true, record, figures):
    drift_chart(CameraPath(estimate, true, record))
    position, rotation = figures[0].axes
    unaligned = lines(position)["unaligned"]
    np.testing.assert_allclose(np.delete(unaligned.get_ydata(), 6), 3.0)
    np.testing.assert_allclose(np.delete(lines(position)["aligned"].get_ydata(), 6), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.delete(lines(rotation)["unaligned"].get_ydata(), 6), 0.0, atol=1e-9)
    assert unaligned.get_xdata()[0] == 0.0
    assert rotation.get_xlabel() == "time [s]"
    (shade,) = position.patches
    assert shade.get_x() == pytest.approx(2.5)  # from the last pose before to the first after
    assert shade.get_width() == pytest.approx(2.0)
    assert any(collection.get_label() == "1 sigma, predicted by the tracker" for collection in position.collections)


def test_a_sigma_without_bounds_does_not_press_the_errors_flat(estimate, true, record, figures):
    frames = list(record.frames)
    frames[3] = frames[3].model_copy(update={"covariance": (1e6 * np.eye(6)).tolist()})
    drift_chart(CameraPath(estimate, true, TrackingRecord(frames=tuple(frames))))
    assert 3.0 < figures[0].axes[0].get_ylim()[1] < 15.0


def test_lost_at_both_ends(true, figures):
    statuses = ["lost"] * 2 + ["tracked"] * 16 + ["lost"] * 2
    frames = [TrackedFrame(index=i, timestamp=TIMES[i], status=s) for i, s in enumerate(statuses)]
    kept = Trajectory(TIMES[2:18], true.T_world_camera[2:18])
    path = CameraPath(kept, true, TrackingRecord(frames=tuple(frames)))
    assert path.lost_spans == [(100.0, 101.0), (108.5, 109.5)]
    drift_chart(path)
    assert [shade.get_x() for shade in figures[0].axes[0].patches] == [0.0, 8.5]
    assert lines(figures[0].axes[0])["unaligned"].get_xdata()[1] == 1.0


def test_files_are_pictures(estimate, true, record, tmp_path):
    written = draw_camera_path(CameraPath(estimate, true, record), tmp_path / "new")
    assert [path.name for path in written] == ["trajectory.png", "drift.png"]
    assert all(cv2.imread(str(path)).shape[1] > 800 for path in written)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("count", [1, 2])
def test_one_pose_and_a_camera_that_stands_still(count, tmp_path):
    still = Trajectory(np.arange(float(count)), np.tile(np.eye(4), (count, 1, 1)))
    frame = TrackedFrame(index=0, timestamp=0.0, status="tracked")  # without a covariance
    for path in (CameraPath(still), CameraPath(still, still), CameraPath(still, None, TrackingRecord(frames=(frame,)))):
        assert draw_camera_path(path, tmp_path)[0].is_file()
    assert drift_chart(CameraPath(still)) is None


def test_poses_that_are_not_finite_are_not_drawn(estimate, true, figures):
    broken = Trajectory(estimate.timestamps, estimate.T_world_camera.copy())
    broken.T_world_camera[4] = np.nan
    trajectory_chart(CameraPath(broken, true))
    assert len(lines(figures[0].axes[0])["estimated, aligned"].get_xdata()) == len(estimate) - 1
    nothing = Trajectory(np.zeros(1), np.full((1, 4, 4), np.nan))
    with pytest.raises(DataError, match="no finite pose"):
        trajectory_chart(CameraPath(nothing, true))


def test_a_truth_of_another_time_is_no_truth(estimate, true, figures):
    late = Trajectory(true.timestamps + 1000, true.T_world_camera)
    path = CameraPath(estimate, late)
    assert path.matched is None
    trajectory_chart(path)
    assert "estimated" in lines(figures[0].axes[0])
    assert drift_chart(path) is None
