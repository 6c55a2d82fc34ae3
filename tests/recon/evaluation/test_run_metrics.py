"""Scores of a run of a box room with known errors."""

import json
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from uncle.recon.core.errors import DataError, RunError
from uncle.recon.core.events import Progress
from uncle.recon.core.json_values import to_plain
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.evaluation.run_metrics import score_run
from uncle.recon.evaluation.surface_metrics import EvaluationSettings, score_surface, write_error_mesh
from uncle.recon.evaluation.visibility import Visibility
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames

QUICK = EvaluationSettings(samples=20_000, views=5, completeness_to="surface")


@pytest.fixture
def mapped_run(make_box_run, box_room) -> RunDirectory:
    """A run as the later stages leave it: walls 1 cm too far, camera 3 cm off, two frames held out."""
    run = make_box_run()
    walls = box_room.mesh(grow_m=0.01)
    colors = np.full((len(walls.vertices), 3), 90, np.uint8)
    replace(walls, colors=colors, sigma=np.full(len(walls.vertices), 0.02, np.float32)).save(run.mesh_path)
    true = Trajectory.load(run.reference_trajectory_path)
    poses = true.T_world_camera.copy()
    poses[:, 2, 3] += 0.03
    Trajectory(true.timestamps, poses).save(run.trajectory_path)
    run.finish_stage("map", "0", time.time(), {"held_out": [3, 7], "sensors": ["noisy"]})
    return run


def test_everything_is_scored(mapped_run):
    metrics = score_run(mapped_run, QUICK)
    assert metrics.skipped == {}
    assert metrics.surface.mesh.settings.culled
    assert metrics.surface.mesh.accuracy_mean_m == pytest.approx(0.01, abs=5e-4)
    assert metrics.surface.mesh.completeness_mean_m == pytest.approx(0.01, abs=1e-3)
    assert [score.f_score for score in metrics.surface.mesh.scores] == [1.0, 1.0]
    assert 0.01 <= metrics.surface.novel_views.l1_all_m < 0.02
    assert metrics.trajectory.ate_m.rmse == pytest.approx(0.03, abs=1e-6)
    assert metrics.trajectory.ate_aligned_m.rmse == pytest.approx(0.0, abs=1e-6)


def test_held_out_frames_are_compared_with_the_ground_truth(mapped_run, box_room):
    held_out = score_run(mapped_run, QUICK).held_out
    assert set(held_out) == {"gt"}
    poses = [box_room.pose(2 * np.pi * index / 12) for index in (3, 7)]
    expected = np.mean([box_room.depth(T, grow_m=0.01) - box_room.depth(T) for T in poses])
    assert held_out["gt"].l1_m == pytest.approx(expected, abs=2e-4)  # depth is stored in whole millimetres
    assert (held_out["gt"].frames, held_out["gt"].completeness) == (2, 1.0)


def test_held_out_frames_are_compared_with_their_images(mapped_run):
    shown = [RunFrames(mapped_run).color(index).numpy() for index in (3, 7)]
    metrics = score_run(mapped_run, QUICK).held_out_color
    expected = np.mean([-10 * np.log10(np.mean(((image - 90.0) / 255) ** 2)) for image in shown])
    assert metrics.psnr_db == pytest.approx(expected, abs=1e-3)
    assert (metrics.frames, metrics.completeness) == (2, 1.0)


def test_images_that_are_gone_cost_the_colours_alone(mapped_run):
    mapped_run.color_path("all.jpg").unlink()
    metrics = score_run(mapped_run, QUICK)
    assert set(metrics.held_out) == {"gt"}
    assert "all.jpg" in metrics.skipped["held_out_color"]


def test_depth_that_is_gone_costs_the_depth_alone(mapped_run):
    mapped_run.depth_path("gt", 3).unlink()
    metrics = score_run(mapped_run, QUICK)
    assert metrics.held_out == {}
    assert metrics.held_out_color.frames == 2
    assert metrics.skipped["held_out"]


def test_a_mesh_without_colours_is_said_to_have_none(mapped_run):
    mesh = Mesh.load(mapped_run.mesh_path)
    replace(mesh, colors=None).save(mapped_run.mesh_path)
    metrics = score_run(mapped_run, QUICK)
    assert metrics.held_out_color is None
    assert "no colours" in metrics.skipped["held_out_color"]


def test_uncertainty_of_a_sensor_that_states_its_scale(mapped_run):
    uncertainty = score_run(mapped_run, QUICK).uncertainty
    assert set(uncertainty) == {"noisy"}
    noisy = uncertainty["noisy"]
    assert noisy.measurements == 12 * 160 * 120
    assert noisy.coverage_50 == pytest.approx(0.5, abs=0.02)
    assert noisy.coverage_90 == pytest.approx(0.9, abs=0.02)
    assert noisy.nll_nats < noisy.nll_constant_nats
    assert noisy.rank_correlation > 0.2
    # Its scale is a function of the true depth. A reading far beyond the walls gives itself away to the fit.
    assert noisy.ause_depth < noisy.ause < noisy.ause_random
    assert noisy.nll_depth_nats == pytest.approx(noisy.nll_nats, abs=0.1)


def test_calibrated_quantiles_are_scored_where_the_map_has_them(mapped_run):
    assert score_run(mapped_run, QUICK).uncertainty["noisy"].calibrated_coverage_50 is None
    stated = {"noisy": {"50": np.log(2), "90": 2 * np.log(10)}}
    mapped_run.finish_stage("map", "1", time.time(), {"sensors": ["noisy"], "error_quantiles_in_beta": stated})
    noisy = score_run(mapped_run, QUICK).uncertainty["noisy"]
    assert noisy.calibrated_coverage_50 == noisy.coverage_50
    assert noisy.calibrated_coverage_90 == pytest.approx(0.99, abs=0.01)


def test_sigma_of_vertices_is_compared_with_their_distance(mapped_run):
    """The corners are off by 1 cm on three sides, sqrt(3) cm, and state 2 cm."""
    metrics = score_run(mapped_run, QUICK).surface.vertex_sigma
    assert metrics.vertices == 8
    assert metrics.median_in_sigmas == pytest.approx(np.sqrt(3) / 2, rel=1e-3)
    assert (metrics.coverage_1_sigma, metrics.coverage_2_sigma, metrics.rank_correlation) == (1.0, 1.0, None)


def test_a_mesh_without_sigma_says_so(mapped_run, box_room):
    box_room.mesh().save(mapped_run.mesh_path)
    metrics = score_run(mapped_run, QUICK)
    assert metrics.surface.vertex_sigma is None
    assert "no sigma" in metrics.skipped["vertex_sigma"]


def test_reasons_are_given_for_what_is_not_there(make_box_run, box_room):
    run = make_box_run(("noisy",))
    manifest = run.load_manifest()
    manifest.reference_mesh = None
    run.save_manifest(manifest)
    box_room.mesh().save(run.mesh_path)
    shutil.copy(run.reference_trajectory_path, run.trajectory_path)
    metrics = score_run(run, QUICK)
    assert metrics.surface is None
    assert "no ground-truth mesh" in metrics.skipped["mesh"]
    assert "held out" in metrics.skipped["held_out"]
    assert "ground-truth depth" in metrics.skipped["uncertainty"]
    assert any("given" in note for note in metrics.notes)


def test_held_out_frames_without_ground_truth_use_the_mapped_sensors(make_box_run, box_room):
    run = make_box_run(("noisy", "other"))
    box_room.mesh().save(run.mesh_path)
    run.finish_stage("map", "0", time.time(), {"held_out": [1], "sensors": ["other"]})
    metrics = score_run(run, QUICK)
    assert set(metrics.held_out) == {"other"}
    assert metrics.held_out["other"].l1_m > 0.005
    assert "no trajectory" in metrics.skipped["trajectory"]


@pytest.mark.parametrize("held_out", [[], None, [99]])
def test_held_out_lists_that_name_no_frame(mapped_run, held_out):
    mapped_run.finish_stage("map", "0", time.time(), {"held_out": held_out})
    assert "held" in score_run(mapped_run, QUICK).skipped["held_out"]


def test_missing_and_broken_files_are_reported_not_raised(mapped_run):
    mapped_run.mesh_path.unlink()
    mapped_run.trajectory_path.write_text("nonsense\n")
    mapped_run.beta_path("noisy", 4).write_bytes(b"not a picture")
    mapped_run.finish_stage("map", "0", time.time(), {})
    with pytest.raises(RunError, match=r"nothing .* can be scored") as caught:
        score_run(mapped_run, QUICK)
    message = str(caught.value)
    assert "uncle mesh" in message
    assert "line 1" in message
    assert "000004.png" in message


def test_reference_that_moved_away_is_named(mapped_run, tmp_path):
    (tmp_path / "reference.ply").unlink()
    assert "reference.ply no longer exists" in score_run(mapped_run, QUICK).skipped["mesh"]


def test_no_run_is_an_error(tmp_path):
    with pytest.raises(RunError, match="uncle preprocess"):
        score_run(RunDirectory(tmp_path))


def test_metrics_are_plain_json_and_repeatable(mapped_run):
    first, again = score_run(mapped_run, QUICK), score_run(mapped_run, QUICK)
    assert first == again
    first.save(mapped_run.metrics_path)
    stored = json.loads(mapped_run.metrics_path.read_text())
    assert stored == to_plain(again)
    assert stored["surface"]["mesh"]["scores"][0]["threshold_m"] == 0.05
    assert stored["uncertainty"]["noisy"]["curves"]["nominal"][0] == 0.05
    assert stored["settings"]["samples"] == 20_000


def test_progress_is_told(mapped_run):
    events = []
    score_run(mapped_run, QUICK, events.append)
    stages = {event.stage: event for event in events if isinstance(event, Progress)}
    assert stages["uncertainty, noisy"].done == stages["uncertainty, noisy"].total == 12


def test_what_is_not_finite_becomes_null():
    assert to_plain({"a": (float("nan"), float("inf"), 1.0), "b": None}) == {"a": [None, None, 1.0], "b": None}


def test_views_default_by_protocol():
    assert EvaluationSettings().view_settings.views == 100
    assert EvaluationSettings(protocol="paper").view_settings.views == 1000
    assert EvaluationSettings(protocol="paper", views=3).view_settings.views == 3


def test_no_views_and_unusable_views_are_skipped_with_a_reason(box_room):
    none = score_surface(box_room.mesh(), box_room.mesh(), EvaluationSettings(samples=1000, views=0))
    assert none.novel_views is None
    assert "novel_views" in none.skipped
    triangle = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32))
    flat = score_surface(triangle, triangle, EvaluationSettings(samples=1000, views=2))
    assert flat.mesh.scores[0].precision == 1.0
    assert "room" in flat.skipped["novel_views"]


def test_error_mesh_needs_a_scored_mesh(tmp_path, box_room):
    with pytest.raises(DataError, match="not scored"):
        write_error_mesh(tmp_path / "error.ply", box_room.mesh(), box_room.mesh(), None)


def test_culling_by_half_the_room_asks_for_that_half_only(make_box_run, box_room):
    cull = Visibility.of_run(make_box_run(angles=np.linspace(-0.4, 0.4, 6)))
    mesh = box_room.mesh()
    without_back_wall = Mesh(mesh.vertices, np.delete(mesh.faces, [8, 9], axis=0))  # x = 0, behind all cameras
    culled = score_surface(without_back_wall, mesh, QUICK, cull).mesh.scores[0]
    whole = score_surface(without_back_wall, mesh, QUICK).mesh.scores[0]
    assert culled.recall == 1.0
    assert whole.recall < 0.95
