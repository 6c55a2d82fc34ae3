"""The report of small runs made through the contracts."""

import json
import re
import time

import numpy as np
import pytest
from uncle.recon.core.errors import RunError
from uncle.recon.core.files import write_image, write_text
from uncle.recon.evaluation.noise_curves import collect_beta_samples, incidence_angle, noise_curves
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames, encode_normals
from uncle.recon.stages.report import report_run
from uncle.recon.visualization.metrics_table import metric_rows
from uncle.recon.visualization.report_charts import (
    reliability_chart,
    reliability_curves,
    uncertainty_calibration_chart,
    vertex_sigma_chart,
)

SECTIONS = ("Overview", "Mesh", "Camera", "Metrics", "Sensors", "Curves", "Time and memory", "Configuration")
NASTY = '<script>alert(\'$x_1$ & "co")</script>'


@pytest.fixture
def full_run(make_box_run, box_room):
    run = make_box_run(angles=np.linspace(0, 4, 3))
    camera = run.load_camera()
    for index in range(3):
        rays = camera.rays().numpy()
        facing = -rays / np.linalg.norm(rays, axis=-1, keepdims=True)
        write_image(run.normal_path("noisy", index), encode_normals(facing))
    box_room.mesh(grow_m=0.01).save(run.mesh_path)
    curve = {"x": [0, 1, 2], "y": [3.0, None, 1.0], "x_label": "iteration", "y_label": "nats"}
    write_text(run.curves_path, json.dumps({"loss": curve, "beta $\\frac": curve, "broken": {"x": [1], "y": "no"}}))
    write_text(run.trajectory_path, run.reference_trajectory_path.read_text())
    metrics = {
        "surface": {"mesh": {"accuracy_mean_m": 0.0123, "scores": [{"threshold_m": 0.05, "f_score": 0.987}]}},
        "notes": [], "name": NASTY, "uncertainty": {"noisy": {"nll_nats": -2.0, "curves": {"nominal": []}}},
    }  # fmt: skip
    write_text(run.metrics_path, json.dumps(metrics))
    write_text(run.config_path, f'method = "uncle" # {NASTY}\n')
    facts = {"method": "uncle", "sensors": ["noisy"], "peak_memory_mb": 512.0, NASTY: 1}
    run.finish_stage("map", "0", time.time() - 12, facts)
    manifest = run.load_manifest()
    manifest.name = NASTY
    run.save_manifest(manifest)
    return run


@pytest.fixture
def page(full_run):
    return report_run(full_run, "raycast").read_text()


def test_page_needs_nothing_else(page):
    targets = re.findall(r'(?:src|href|url)\s*[=(]\s*["\']?([^"\'\s)>]{0,20})', page)
    assert targets
    assert all(target.startswith(("data:image/", "#")) for target in targets)
    assert "<script" not in page
    assert len(page) < 5e6


def test_page_has_every_section_and_its_figures(page):
    for title in SECTIONS:
        assert f">{title}</h2>" in page
    assert page.count("<img") >= 7  # surface and error of the mesh, way and drift of the camera, sensor, noise, curves
    for text in ("F-score", "98.7", "1.23", "at 5 cm", "512", "MB", "Sensor noisy"):
        assert text in page
    assert 'class="missing"' not in page


def test_charts_of_calibration_need_whole_curves():
    curves = {"nominal": [0.5, 0.9], "empirical": [0.4, 0.8]}
    size = {"bin_sigma_m": [0.01, 0.02], "bin_distance_rms_m": [0.01, None]}
    surface = {"vertex_sigma": {"curves": {**curves, **size}}}
    metrics = {"uncertainty": {"sl": {"curves": curves}, "sgm": {"curves": curves}}, "surface": surface}
    found = reliability_curves(metrics)
    assert list(found) == ["sl", "sgm", "vertices of the mesh"]
    assert reliability_chart(found).startswith(b"\x89PNG")
    assert reliability_chart({"sl": curves}) != reliability_chart(found)
    assert reliability_curves({"uncertainty": None, "surface": {"vertex_sigma": None}}) == {}
    for broken in ({}, {"sl": {}}, {"sl": 1}, {"sl": curves | {"nominal": [1]}}, {"sl": curves | {"empirical": "no"}}):
        assert reliability_chart(broken) is None
    assert vertex_sigma_chart({**curves, **size}).startswith(b"\x89PNG")
    assert vertex_sigma_chart(curves) is None
    names = ("bin_beta_m", "bin_error_m", "removed", "error_by_beta", "error_oracle")
    whole = {name: [0.1, 0.2] for name in names}
    plain = uncertainty_calibration_chart("sl", curves | whole)
    assert uncertainty_calibration_chart("sl", curves | whole | {"error_by_depth": []}) == plain
    assert uncertainty_calibration_chart("sl", curves | whole | {"error_by_depth": [0.3, 0.1]}) != plain


def test_calibration_is_shown_for_the_mesh_and_for_all_together(full_run):
    curves = {"nominal": [0.5, 0.9], "empirical": [0.4, 0.8], "bin_sigma_m": [0.1], "bin_distance_rms_m": [0.1]}
    scores = {"surface": {"vertex_sigma": {"curves": curves}}, "uncertainty": {"noisy": {"curves": curves}}}
    write_text(full_run.metrics_path, json.dumps(scores))
    page = report_run(full_run, "raycast").read_text()
    for caption in ("Sigma of the vertices against", "Reliability diagram"):
        assert page.count(f"<figcaption>{caption}") == 1


def test_sensors_are_set_side_by_side(full_run):
    assert 'weight share</td><td class="number">-</td>' in report_run(full_run, "raycast").read_text()
    full_run.finish_stage("map", "0", time.time(), {"sensor_weight_share": {"noisy": 0.625}})
    page = report_run(full_run, "raycast").read_text()
    assert 'weight share</td><td class="number">62.5</td><td>%</td>' in page
    assert re.search(r"beta at 2 m</td><td class=\"number\">(3\.9|4\.[01])\d</td><td>cm</td>", page)


def test_names_are_escaped(page):
    assert NASTY not in page
    assert page.count("&lt;script&gt;alert") >= 4  # title, metrics, facts, configuration


def test_missing_parts_name_their_commands(make_box_run):
    run = make_box_run(angles=np.linspace(0, 4, 2))
    for path in (run.root / "beta" / "noisy").glob("*.png"):
        path.unlink()
    page = report_run(run, "raycast").read_text()
    for title in SECTIONS:
        assert f">{title}</h2>" in page
    for command in ("uncle map", "uncle mesh", "uncle eval"):
        assert f"<code>{command} --run {run.root}</code>" in page


def test_broken_parts_cost_their_section_only(full_run):
    full_run.mesh_path.write_bytes(b"no mesh")
    full_run.metrics_path.write_text("{")
    full_run.curves_path.write_text("[1]")
    events = []
    page = report_run(full_run, "raycast", events.append).read_text()
    assert "is no PLY file" in page
    assert "uncle eval" in page
    assert any("is no PLY file" in getattr(event, "text", "") for event in events)


def test_no_run_is_an_error(tmp_path):
    with pytest.raises(RunError, match="uncle preprocess"):
        report_run(RunDirectory(tmp_path))


def test_noise_curve_is_that_of_the_sensor(make_box_run):
    """The sensor's Laplace scale is 1 % of depth squared, and its beta maps say so."""
    samples = collect_beta_samples(RunFrames(make_box_run()), "noisy")
    assert samples is not None
    noise = noise_curves(samples).by_depth
    known = np.isfinite(noise.beta) & (noise.x > 1.0)
    assert known.sum() >= 4
    np.testing.assert_allclose(noise.beta[known], 0.01 * noise.x[known] ** 2, rtol=0.1)
    ratio = noise.error[known] / noise.beta[known]  # of a Laplace scale and its mean absolute error
    assert ratio.mean() == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(ratio, 1.0, atol=0.4)  # bins are by measured depth, which prefers some errors


def test_incidence_is_zero_where_the_surface_faces_the_camera(full_run):
    angles = incidence_angle(RunFrames(full_run), 0, "noisy")
    assert np.nanmax(angles) < 1.5  # stored normals are rounded


def test_metric_rows_know_units_and_keep_groups_together():
    metrics = {
        "ate_m": {"rmse": 0.021}, "frames": 12345, "ratio": 0.5, "rpe_rotation_rad": {"max": np.pi}, "flag": True,
        "scores": [{"threshold_m": 0.02, "recall": 0.25}], "curve": list(range(100)), "none": None, "empty": [],
        "bad": float("nan"),
    }  # fmt: skip
    rows = [(row.group, row.name, row.value, row.unit) for row in metric_rows(metrics)]
    assert rows == [
        ("", "frames", "12 345", ""), ("", "ratio", "50.0", "%"), ("", "flag", "yes", ""),
        ("", "bad", "not finite", ""), ("ate", "rmse", "2.10", "cm"), ("rpe rotation", "max", "180.00", "°"),
        ("scores / at 2 cm", "threshold", "2.00", "cm"), ("scores / at 2 cm", "recall", "25.0", "%"),
    ]  # fmt: skip
