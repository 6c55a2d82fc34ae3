"""Files of poses of different formats are compared by time stamps, frame numbers or order."""

import numpy as np
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.evaluation.trajectory_files import load_trajectories
from uncle.recon.evaluation.trajectory_metrics import evaluate_trajectory

COUNT = 20
X = np.linspace(0, 2, COUNT)
TUM = [f"{50.05 + 0.1 * i:.2f} {x:.6f} 0 0 0 0 0 1" for i, x in enumerate(X)]
FRAMES = [f"{i} {x:.6f} 0 0 0 0 0 1" for i, x in enumerate(X)]
KITTI = [f"1 0 0 {x:.6f} 0 1 0 0 0 0 1 0" for x in X + 0.01]
LOG = [f"{i} {i} {COUNT}\n1 0 0 {x:.6f}\n0 1 0 0\n0 0 1 0\n0 0 0 1" for i, x in enumerate(X + 0.01)]
EUROC = [f"{50_050_000_000 + 100_000_000 * i},{x:.6f},0,0,1,0,0,0" for i, x in enumerate(X + 0.01)]
UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
HEADER = "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []\n"


@pytest.fixture
def compare(tmp_path):
    """Lines of an estimate and of the truth -> trajectory errors and warnings."""

    def run(estimate, truth):
        (tmp_path / "estimate.txt").write_text("\n".join(estimate) + "\n")
        (tmp_path / "truth.txt").write_text("\n".join(truth) + "\n")
        notes = []
        pair = load_trajectories(tmp_path / "estimate.txt", tmp_path / "truth.txt", lambda e: notes.append(e.text))
        return evaluate_trajectory(*pair), notes

    return run


@pytest.mark.parametrize(
    ("estimate", "truth"),
    [(TUM, [HEADER.strip(), *EUROC]), (FRAMES, KITTI), (FRAMES, LOG), (KITTI, FRAMES)],
    ids=["time", "frame-kitti", "frame-log", "kitti-frame"],
)
def test_the_same_frames_meet_without_a_word(compare, estimate, truth):
    metrics, notes = compare(estimate, truth)
    assert metrics.matched_poses == COUNT
    assert metrics.ate_m.rmse == pytest.approx(0.01, abs=1e-6)
    assert notes == []


def test_numbers_decide_where_frames_are_missing(compare):
    metrics, notes = compare([line for i, line in enumerate(FRAMES) if i % 3], LOG)
    assert metrics.ate_m.max == pytest.approx(0.01, abs=1e-6)
    assert metrics.matched_poses == 13
    assert notes == []


def test_as_many_poses_are_matched_in_order_and_that_is_named(compare):
    metrics, notes = compare(TUM, KITTI)
    assert metrics.matched_poses == COUNT
    assert metrics.ate_m.rmse == pytest.approx(0.01, abs=1e-6)
    assert "truth.txt has no time stamps: its 20 poses are matched to those of" in notes[0]


def test_other_counts_cannot_be_matched_in_order(compare):
    with pytest.raises(DataError, match=r"20 poses with time stamps and .* 19 without: it cannot be told"):
        compare(TUM, KITTI[1:])


def test_poses_that_are_counted_are_doubted_where_some_are_missing(compare):
    _, notes = compare(KITTI, KITTI[:-1])
    assert len(notes) == 1
    assert "its poses count from 0, though there are 20 estimated and 19 true poses" in notes[0]


@pytest.mark.parametrize("scale", [1e3, 1e6, 1e9])
def test_time_stamps_of_another_unit_are_named(compare, scale):
    start = 1_600_000_000
    estimate = [f"{round((start + 0.1 * i) * scale)} {x:.6f} 0 0 0 0 0 1" for i, x in enumerate(X)]
    truth = [f"{start + 0.1 * i:.3f} {x + 0.01:.6f} 0 0 0 0 0 1" for i, x in enumerate(X)]
    metrics, notes = compare(estimate, truth)
    assert metrics.matched_poses == COUNT
    assert metrics.ate_m.rmse == pytest.approx(0.01, abs=1e-6)
    assert [note.split(" are read as ")[1] for note in notes] == [UNITS[scale]]


def test_poses_that_cannot_be_used_are_counted(compare):
    lost = [*FRAMES[:4], "4 nan nan nan nan nan nan nan", *FRAMES[5:]]
    metrics, notes = compare(lost, LOG)
    assert metrics.matched_poses == COUNT - 1
    assert len(notes) == 1
    assert notes[0].startswith("1 of 20 poses cannot be used (")
    assert "estimate.txt, line 5: its numbers are not finite" in notes[0]


def test_a_file_without_a_usable_pose_is_refused(compare):
    with pytest.raises(DataError, match=r"none of the 2 poses of .*truth\.txt can be used \(the first: "):
        compare(FRAMES, ["0 nan nan nan 0 0 0 1", "1 nan nan nan 0 0 0 1"])


def test_names_of_images_are_matched_by_their_numbers(compare):
    named = [f"rgb/{line.split()[0]}.png {' '.join(line.split()[1:])}" for line in FRAMES[3:]]
    metrics, notes = compare(named, LOG)
    assert metrics.ate_m.rmse == pytest.approx(0.01, abs=1e-6)
    assert metrics.matched_poses == COUNT - 3
    assert notes == []
