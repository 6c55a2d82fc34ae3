"""`uncle eval` as a user meets it."""

import json
import time
import warnings
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner, Result
from uncle.cli.main import main
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.mesh_raycaster import sample_surface
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.run.tracking_record import TrackedFrame, TrackingRecord

FAST = ["--samples", "5000", "--views", "3"]


def uncle(*arguments: object) -> Result:
    return CliRunner().invoke(main, ["eval", *map(str, arguments)])


@pytest.fixture
def meshes(tmp_path, box_room):
    """Paths of a mesh with walls 1 cm too far, and of the truth."""
    paths = tmp_path / "mesh.ply", tmp_path / "gt.ply"
    box_room.mesh(grow_m=0.01).save(paths[0])
    box_room.mesh().save(paths[1])
    return paths


@pytest.fixture
def run(make_box_run, box_room):
    run = make_box_run()
    walls = box_room.mesh(grow_m=0.01)
    replace(walls, colors=np.full((len(walls.vertices), 3), 90, np.uint8)).save(run.mesh_path)
    run.trajectory_path.write_bytes(run.reference_trajectory_path.read_bytes())
    run.finish_stage("map", "0", time.time(), {"held_out": [3], "sensors": ["noisy"]})
    return run


def test_table_for_people(meshes):
    result = uncle(*meshes, "--completeness-to", "surface", *FAST)
    assert result.exit_code == 0, result.output
    for text in ("F-score at 5 cm", "F-score at 2 cm", "100.00", "1.00 / 1.00", "cm", "seed 0", "5000 samples"):
        assert text in result.stdout


def test_json_for_machines_carries_settings_and_ratios(meshes):
    result = uncle(*meshes, "--threshold", 0.05, "--threshold", 0.005, "--seed", 3, "--json", *FAST)
    assert result.exit_code == 0, result.output
    stored = json.loads(result.stdout)
    assert [score["threshold_m"] for score in stored["mesh"]["scores"]] == [0.05, 0.005]
    assert [score["precision"] for score in stored["mesh"]["scores"]] == [1.0, 0.0]
    assert stored["mesh"]["accuracy_mean_m"] == pytest.approx(0.01, abs=1e-3)
    assert stored["mesh"]["settings"] == {
        "protocol": "standard", "completeness_to": "samples", "samples": 5000, "seed": 3, "icp": False, "culled": False,
    }  # fmt: skip
    assert stored["novel_views"]["views"] == 3


def test_paper_protocol_aligns_unless_told_not_to(meshes):
    paper = json.loads(uncle(*meshes, "--protocol", "paper", "--views", 0, "--json").stdout)
    assert paper["mesh"]["settings"]["icp"]
    assert paper["mesh"]["settings"]["samples"] is None
    plain = json.loads(uncle(*meshes, "--protocol", "paper", "--no-icp", "--views", 0, "--json").stdout)
    assert not plain["mesh"]["settings"]["icp"]


def test_culled_by_a_run(meshes, run):
    stored = json.loads(uncle(*meshes, "--cull", run.root, "--json", *FAST).stdout)
    assert stored["mesh"]["settings"]["culled"]
    assert stored["cull"] == str(run.root)
    assert stored["novel_views"]["culled"]


def test_error_mesh_is_written_in_colour(meshes, tmp_path):
    target = tmp_path / "error.ply"
    assert uncle(*meshes, "--error-mesh", target, *FAST).exit_code == 0
    assert Mesh.load(target).colors.shape == (8, 3)


def test_a_point_cloud_is_a_ground_truth(meshes, tmp_path, box_room, run):
    """Points on the walls: the mesh, 1 cm off, lies 1 cm from each, and further from its nearest by their spacing."""
    points = sample_surface(box_room.mesh(), 20_000, np.random.default_rng(5))
    np.savetxt(tmp_path / "cloud.xyz", points)
    result = uncle(meshes[0], tmp_path / "cloud.xyz", "--completeness-to", "surface", "--json", *FAST)
    assert result.exit_code == 0, result.output
    stored = json.loads(result.stdout)
    assert stored["mesh"]["completeness_mean_m"] == pytest.approx(0.01, abs=1e-3)
    assert 0.01 < stored["mesh"]["accuracy_mean_m"] < 0.06
    assert stored["mesh"]["reference_points"] == 5000
    assert "cloud of 20000 points, 5000 of them scored" in stored["notes"][0]
    assert set(stored["skipped"]) == {"novel_views", "vertex_sigma"}
    options = ["--completeness-to", "surface", "--cull", run.root, "--json"]
    culled = json.loads(uncle(meshes[0], tmp_path / "cloud.xyz", *options, *FAST).stdout)
    assert culled["mesh"]["settings"]["culled"]
    assert culled["mesh"]["scores"][0]["recall"] == 1.0


def test_a_ground_truth_in_millimetres_is_named(meshes, tmp_path, box_room):
    truth = box_room.mesh()
    replace(truth, vertices=truth.vertices * 1000).save(tmp_path / "mm.ply")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result = uncle(meshes[0], tmp_path / "mm.ply", *FAST)
    assert result.exit_code == 0, result.output
    assert "times that of the mesh" in result.stdout
    assert "in millimetres; divide its coordinates by 1000" in result.stdout
    assert "nan" not in result.output


def test_run_is_scored_and_the_figures_kept(run):
    result = uncle("--run", run.root, *FAST)
    assert result.exit_code == 0, result.output
    for text in (
        "Surface",
        "Trajectory",
        "Depth of held-out frames",
        "Colour of held-out frames",
        "Uncertainty of noisy",
        "the camera poses were given",
    ):
        assert text in result.stdout
    stored = json.loads(run.metrics_path.read_text())
    assert set(stored["uncertainty"]) == {"noisy"}
    assert json.loads(uncle("--run", run.root, "--json", *FAST).stdout) == stored


def test_run_says_what_could_not_be_scored(run):
    run.mesh_path.unlink()
    result = uncle("--run", run.root, *FAST)
    assert result.exit_code == 0
    assert "has no mesh; make it with `uncle mesh" in result.stdout
    assert "not scored: held out:" in result.stdout


def _empty_mesh(folder):
    path = folder / "empty.ply"
    Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)).save(path)
    return path


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["absent.ply", "gt.ply"], 1, "there is no mesh at"),
        (["mesh.ply", "absent.ply"], 1, "there is no mesh at"),
        (["empty.ply", "gt.ply"], 1, "holds no triangles"),
        (["mesh.ply", "empty.ply"], 1, "holds no triangles"),
        (["points.xyz", "gt.ply"], 1, "points.xyz holds no triangles, only 3 points"),
        (["mesh.ply", "points.xyz", "--protocol", "paper"], 1, "needs a ground truth with triangles"),
        (["mesh.ply", "broken.obj"], 1, "broken.obj: 1 of 3 vertices are not finite"),
        (["mesh.ply", "gt.ply", "--error-mesh", "error.foo"], 1, ".foo is no mesh format that is written"),
        (["mesh.ply"], 2, "give both MESH and GT"),
        (["mesh.ply", "gt.ply", "--cull", "nowhere"], 1, "holds no run"),
        (["--run", "nowhere"], 1, "holds no run"),
        (["--cull", "nowhere"], 2, "--cull needs MESH and GT"),
        (["mesh.ply", "gt.ply", "--threshold", "0"], 2, "--threshold"),
        (["mesh.ply", "gt.ply", "--samples", "0"], 2, "--samples"),
    ],
)
def test_mistakes_end_in_one_line(meshes, tmp_path, arguments, code, message):
    _empty_mesh(tmp_path)
    (tmp_path / "points.xyz").write_text("0 0 0\n1 0 0\n0 1 0\n")
    (tmp_path / "broken.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 nan 0\nf 1 2 3\n")
    files = (".ply", ".xyz", ".obj", ".foo")
    paths = [tmp_path / a if a.endswith(files) or a == "nowhere" else a for a in arguments]
    result = uncle(*paths)
    assert result.exit_code == code
    assert message in result.output
    errors = [line for line in result.stderr.splitlines() if line.startswith("Error")]
    assert len(errors) == 1
    assert isinstance(result.exception, SystemExit)


@pytest.fixture
def trajectories(tmp_path):
    """Paths of a trajectory that drifts by 2 cm a metre sideways, and of the truth: 4 m in 8 s."""
    times, poses = 50.0 + 0.1 * np.arange(81), np.tile(np.eye(4), (81, 1, 1))
    poses[:, 0, 3] = 0.05 * np.arange(81)
    Trajectory(times, poses).save(tmp_path / "groundtruth.txt")
    poses[:, 1, 3] = 0.02 * poses[:, 0, 3]
    Trajectory(times, poses).save(tmp_path / "trajectory.txt")
    (tmp_path / "late.txt").write_text("9000.5 0 0 0 0 0 0 1\n")
    (tmp_path / "empty.txt").write_text("# timestamp tx ty tz qx qy qz qw\n")
    (tmp_path / "nan.txt").write_text("50.0 nan nan nan nan nan nan nan\n")
    (tmp_path / "one.txt").write_text("50.0 0 0 0.03 0 0 0 1\n")
    (tmp_path / "words.txt").write_text("50.0 0 0 0 0 0 0 1\n51.0 a b c\n")
    (tmp_path / "mesh.ply").touch()
    return tmp_path / "trajectory.txt", tmp_path / "groundtruth.txt"


def test_two_trajectories_as_table_and_pictures(trajectories, tmp_path):
    result = uncle(*trajectories, "--plot", tmp_path / "plots")
    assert result.exit_code == 0, result.output
    for text in ("trajectory.txt against groundtruth.txt", "ATE (aligned)", "RPE translation over 1 s", "81 / 81"):
        assert text in result.stdout
    rows = {line.split("│")[1].strip(): line.split("│")[2].strip() for line in result.stdout.splitlines()
            if line.startswith("│")}  # fmt: skip
    assert rows["drift over 1 m of path, translation"] == rows["error growth over the path"] == "2.00"
    assert rows["error growth over time"] == "1.000"
    assert rows["path length"] == "4.00"
    assert sorted(path.name for path in (tmp_path / "plots").iterdir()) == ["drift.png", "trajectory.png"]


def test_two_trajectories_as_json(trajectories, tmp_path):
    result = uncle(*trajectories, "--json")
    assert result.exit_code == 0, result.output
    stored = json.loads(result.stdout)
    assert stored["estimate_path"] == str(trajectories[0])
    assert stored["trajectory"]["rpe_second_translation_m"]["rmse"] == pytest.approx(0.01, abs=1e-6)
    assert stored["trajectory"]["drift"]["segment_translation_ratio"] == pytest.approx(0.02, abs=1e-6)
    one = json.loads(uncle(tmp_path / "one.txt", trajectories[1], "--json").stdout)["trajectory"]
    assert one["ate_m"]["rmse"] == pytest.approx(0.03)
    assert (one["rpe_translation_m"], one["drift"], one["completeness"]) == (None, None, None)
    assert not list(tmp_path.glob("*.png"))


def test_trajectories_of_other_formats(trajectories, tmp_path):
    """The truth as KITTI, without time stamps, and as EuRoC."""
    true = Trajectory.load(trajectories[1])
    np.savetxt(tmp_path / "truth.kitti", true.T_world_camera[:, :3].reshape(-1, 12))
    rows = [
        f"{round(t * 1e9)},{x:.6f},0,0,1,0,0,0"
        for t, x in zip(true.timestamps, true.T_world_camera[:, 0, 3], strict=True)
    ]
    header = "#timestamp [ns],p_x [m],p_y [m],p_z [m],q_w [],q_x [],q_y [],q_z []"
    (tmp_path / "truth.csv").write_text("\n".join([header, *rows]))
    trajectories[0].rename(tmp_path / "estimate.tum")
    expected = json.loads(uncle(tmp_path / "estimate.tum", trajectories[1], "--json").stdout)["trajectory"]
    for name, warning in (("truth.kitti", "in order"), ("truth.csv", "")):
        result = uncle(tmp_path / "estimate.tum", tmp_path / name, "--json")
        assert result.exit_code == 0, result.output
        assert json.loads(result.stdout)["trajectory"]["ate_m"] == pytest.approx(expected["ate_m"], rel=1e-4)
        assert warning in result.stderr
        assert bool(result.stderr) == bool(warning)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["late.txt", "groundtruth.txt"], 1, "share no time stamp"),
        (["empty.txt", "groundtruth.txt"], 1, "empty.txt holds no poses"),
        (["nan.txt", "groundtruth.txt"], 1, "its numbers are not finite"),
        (["words.txt", "groundtruth.txt"], 1, "words.txt, line 2"),
        (["absent.txt", "groundtruth.txt"], 1, "absent.txt"),
        (["trajectory.txt", "mesh.ply"], 2, "give two trajectories (.txt, .tum, .kitti, "),
        (["trajectory.txt"], 2, "give both"),
        (["trajectory.txt", "groundtruth.txt", "--cull", "nowhere"], 2, "are for meshes"),
        (["mesh.ply", "mesh.ply", "--plot", "plots"], 2, "--plot is for trajectories"),
    ],
)
def test_mistakes_with_trajectories_end_in_one_line(trajectories, tmp_path, arguments, code, message):
    result = uncle(*(tmp_path / a if a.endswith((".txt", ".ply")) else a for a in arguments))
    assert result.exit_code == code
    assert message in result.stderr.replace("\n", " ")
    assert len([line for line in result.stderr.splitlines() if line.startswith("Error")]) == 1
    assert isinstance(result.exception, SystemExit)


def test_a_tracked_run_says_how_it_was_tracked(run):
    covariance = (0.01**2 * np.eye(6)).tolist()
    frames = [TrackedFrame(index=i, timestamp=i, status="tracked", covariance=covariance) for i in range(11)]
    frames.append(TrackedFrame(index=11, timestamp=11, status="lost"))
    TrackingRecord(frames=tuple(frames)).save(run.tracking_path)
    lines = run.reference_trajectory_path.read_text().splitlines()
    run.trajectory_path.write_text("\n".join(lines[:-1]) + "\n")
    result = uncle("--run", run.root, *FAST)
    assert result.exit_code == 0, result.output
    for text in ("Tracking", "11 (91.7 %)", "1 of 12 frames were lost: 11.", "frames of the run with a pose", "91.67"):
        assert text in result.stdout
    assert "trajectory.png" in result.stderr
    assert (run.snapshots_path / "drift.png").is_file()
    run.trajectory_path.write_text("# nothing\n")
    result = uncle("--run", run.root, *FAST)
    assert result.exit_code == 0, result.output
    assert "the trajectory is not drawn" in result.stderr


def test_run_with_nothing_to_score(make_box_run):
    run = make_box_run(("gt",))
    result = uncle("--run", run.root)
    assert result.exit_code == 1
    assert "nothing in" in result.output
    assert not run.metrics_path.exists()
