from pathlib import Path

import numpy as np
import pytest
from uncle.recon.core.trajectory import Trajectory

POSE = "0.1 0.2 0.3 0 0 0 1"


def load(folder: Path, *rows: str) -> Trajectory:
    (folder / "trajectory.txt").write_text("\n".join(rows))
    return Trajectory.load(folder / "trajectory.txt")


def test_round_trip(tmp_path):
    trajectory = load(tmp_path, f"1.5 {POSE}", "2.5 1 2 3 0 0 0.6 0.8")
    trajectory.save(tmp_path / "again.txt")
    again = Trajectory.load(tmp_path / "again.txt")
    np.testing.assert_allclose(again.timestamps, [1.5, 2.5])
    np.testing.assert_allclose(again.T_world_camera, trajectory.T_world_camera, atol=1e-8)
    np.testing.assert_allclose(again.T_world_camera[1, :2, :2], [[0.28, -0.96], [0.96, 0.28]], atol=1e-8)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("row", ["nan 0 0 0 0 0 1", "1e300 0 0 0 0 0 1", "0 0 0 0 0 0 0", "0 0 0 1e300 0 0 1e300"])
def test_rows_that_are_no_pose_are_not_finite(tmp_path, row):
    trajectory = load(tmp_path, f"0 {POSE}", f"1 {row}", f"2 {POSE}")
    np.testing.assert_array_equal(trajectory.finite().timestamps, [0, 2])
