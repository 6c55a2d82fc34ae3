"""Scores of meshes whose distance to each other is known."""

import matplotlib
import numpy as np
import open3d as o3d
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.mesh_raycaster import Surface, sample_surface
from uncle.recon.evaluation.mesh_metrics import (
    MeshMetrics,
    MeshScoringOptions,
    align_by_icp,
    color_by_distance,
    evaluate_mesh,
    nearest_distance,
    score_at,
    standard_distances,
    transformed,
)

EMPTY = Mesh(np.zeros((0, 3), dtype="float32"), np.zeros((0, 3), dtype="int32"))


def as_mesh(legacy) -> Mesh:
    return Mesh(np.asarray(legacy.vertices, dtype=np.float32), np.asarray(legacy.triangles, dtype=np.int32))


def sphere(radius: float) -> Mesh:
    return as_mesh(o3d.geometry.TriangleMesh.create_sphere(radius, resolution=60))


def score(mesh: Mesh, reference: Mesh, visible=None, seen_reference=None, **options) -> MeshMetrics:
    """`evaluate_mesh` with `options` by name."""
    scoring = MeshScoringOptions(**options)
    return evaluate_mesh(mesh, reference, scoring, visible=visible, seen_reference=seen_reference)


def plate(width: float) -> Mesh:
    """A `width` x 1 m rectangle in the plane z = 0."""
    corners = np.array([[0, 0, 0], [width, 0, 0], [width, 1, 0], [0, 1, 0]], dtype="float32")
    return Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], dtype="int32"))


def test_concentric_spheres_are_their_radii_apart():
    metrics = score(sphere(1.01), sphere(1.0), thresholds_m=(0.02, 0.005), samples=20_000, completeness_to="surface")
    assert metrics.accuracy_mean_m == pytest.approx(0.01, abs=5e-4)
    assert metrics.completeness_mean_m == pytest.approx(0.01, abs=5e-4)
    wide, narrow = metrics.scores
    assert (wide.precision, wide.recall, wide.f_score) == (1.0, 1.0, 1.0)
    assert (narrow.precision, narrow.recall, narrow.f_score) == (0.0, 0.0, 0.0)


def test_half_missing_mesh_loses_recall_only():
    result = score(plate(1.0), plate(2.0), thresholds_m=(0.05,), samples=50_000).scores[0]
    assert result.precision == 1.0
    assert result.recall == pytest.approx((1.0 + 0.05) / 2.0, abs=0.01)  # the missing half is near for 5 cm
    assert result.f_score == pytest.approx(2 * result.recall / (1 + result.recall))


def test_superfluous_half_loses_precision_only():
    result = score(plate(2.0), plate(1.0), thresholds_m=(0.05,), samples=50_000).scores[0]
    assert result.recall == 1.0
    assert result.precision == pytest.approx((1.0 + 0.05) / 2.0, abs=0.01)


def test_recall_to_sparse_samples_suffers_and_to_the_surface_does_not():
    sparse = {"thresholds_m": (0.02,), "samples": 500}
    assert score(plate(1.0), plate(1.0), **sparse).scores[0].recall < 0.8
    assert score(plate(1.0), plate(1.0), completeness_to="surface", **sparse).scores[0].recall == 1.0


def test_agrees_with_open3d_compute_metrics():
    mesh, reference = sphere(1.0), as_mesh(o3d.geometry.TriangleMesh.create_box(1.5, 1.5, 1.5))
    reference = transformed(reference, np.array([[1, 0, 0, -0.75], [0, 1, 0, -0.75], [0, 0, 1, -0.75], [0, 0, 0, 1.0]]))
    ours = score(mesh, reference, thresholds_m=(0.2,), samples=100_000, completeness_to="surface")
    tensors = [
        o3d.t.geometry.TriangleMesh(o3d.core.Tensor(m.vertices), o3d.core.Tensor(m.faces)) for m in (mesh, reference)
    ]
    metric = o3d.t.geometry.Metric
    parameters = o3d.t.geometry.MetricParameters(fscore_radius=[0.2], n_sampled_points=100_000)
    chamfer, f_score = tensors[0].compute_metrics(tensors[1], (metric.ChamferDistance, metric.FScore), parameters)
    assert 0.3 < ours.scores[0].f_score < 0.95  # a value that says something
    assert ours.scores[0].f_score == pytest.approx(f_score.item() / 100, abs=0.01)
    assert ours.accuracy_mean_m + ours.completeness_mean_m == pytest.approx(chamfer.item(), rel=0.02)


def test_distance_to_the_surface_agrees_with_a_dense_cloud():
    points = np.random.default_rng(0).normal(size=(200, 3))
    dense = nearest_distance(points, sample_surface(sphere(1.0), 400_000, np.random.default_rng(1)))
    np.testing.assert_allclose(Surface(sphere(1.0)).distance(points), dense, atol=0.01)


def test_samples_are_uniform_over_area_and_repeatable():
    big_and_small = Mesh(
        np.array([[0, 0, 0], [3, 0, 0], [0, 2, 0], [10, 0, 0], [11, 0, 0], [10, 2, 0]], dtype="float32"),
        np.array([[0, 1, 2], [3, 4, 5]], dtype="int32"),
    )
    points = sample_surface(big_and_small, 40_000, np.random.default_rng(3))
    assert (points[:, 0] < 5).mean() == pytest.approx(0.75, abs=0.01)
    first = points[points[:, 0] < 5]
    np.testing.assert_allclose(first.mean(axis=0), [1.0, 2 / 3, 0.0], atol=0.02)  # the centroid
    np.testing.assert_array_equal(points, sample_surface(big_and_small, 40_000, np.random.default_rng(3)))


def test_same_seed_same_scores_and_another_seed_others():
    runs = [score(sphere(1.01), sphere(1.0), samples=2000, seed=seed) for seed in (1, 1, 2)]
    assert runs[0] == runs[1]
    assert runs[0].completeness_mean_m != runs[2].completeness_mean_m


def test_icp_undoes_a_small_motion_and_reports_it():
    reference = as_mesh(o3d.geometry.TriangleMesh.create_box(1, 2, 3).subdivide_midpoint(4))
    shift = np.eye(4)
    shift[:3, 3] = [0.03, -0.02, 0.01]
    plain = score(transformed(reference, shift), reference, samples=5000, completeness_to="surface")
    aligned = score(transformed(reference, shift), reference, samples=5000, completeness_to="surface", icp=True)
    assert plain.accuracy_mean_m > 0.01
    assert aligned.accuracy_mean_m < 1e-3
    assert aligned.settings.icp
    np.testing.assert_allclose(np.array(aligned.T_reference_mesh)[:3, 3], -shift[:3, 3], atol=1e-3)
    np.testing.assert_allclose(align_by_icp(reference, reference), np.eye(4), atol=1e-6)


def test_paper_protocol_scores_vertices_and_aligns():
    """A plate with almost all vertices in its wrong half: area says 50 %, vertices say almost nothing is right."""
    dense_far = as_mesh(o3d.geometry.TriangleMesh.create_box(1, 1, 1e-3).subdivide_midpoint(5))
    far = transformed(dense_far, np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1.0], [0, 0, 0, 1]]))
    near = plate(1.0)
    both = Mesh(np.vstack([near.vertices, far.vertices]), np.vstack([near.faces, far.faces + 4]).astype("int32"))
    paper = score(both, plate(1.0), thresholds_m=(0.05,), protocol="paper", icp=False)
    assert paper.scores[0].precision == pytest.approx(4 / len(both.vertices))
    assert paper.scores[0].recall == 1.0
    assert paper.predicted_points == len(both.vertices)
    assert paper.settings.samples is None
    assert score(near, plate(1.0), protocol="paper").settings.icp
    standard = score(both, plate(1.0), thresholds_m=(0.05,), samples=20_000)
    assert standard.scores[0].precision == pytest.approx(1 / 3, abs=0.02)


def test_culling_keeps_what_was_seen_on_both_sides():
    left = {
        "visible": lambda p: p[:, 0] < 1.0,
        "seen_reference": np.stack(np.meshgrid(np.linspace(0, 1, 41), np.linspace(0, 1, 41), [0.0]), -1).reshape(-1, 3),
    }
    result = score(plate(1.0), plate(2.0), thresholds_m=(0.05,), samples=20_000, **left)
    assert result.scores[0].recall == 1.0
    assert result.settings.culled
    assert result.reference_points == 41 * 41
    assert score(plate(2.0), plate(1.0), samples=20_000, **left).scores[0].precision == 1.0
    paper = score(plate(1.0), plate(2.0), protocol="paper", icp=False, **left)
    assert paper.reference_points == 2  # the two vertices at x = 0; those at x = 2 were not seen


@pytest.mark.parametrize("protocol", ["standard", "paper"])
@pytest.mark.parametrize("completeness_to", ["samples", "surface"])
def test_empty_mesh_scores_zero_and_says_so(protocol, completeness_to):
    metrics = score(EMPTY, plate(1.0), samples=100, protocol=protocol, completeness_to=completeness_to)
    assert [s.f_score for s in metrics.scores] == [0.0, 0.0]
    assert [s.recall for s in metrics.scores] == [0.0, 0.0]
    assert metrics.accuracy_mean_m is None
    assert metrics.completeness_mean_m is None
    assert "no surface" in metrics.note


def test_mesh_outside_of_every_view_scores_zero():
    metrics = score(
        plate(1.0), plate(1.0), samples=100, visible=lambda p: np.zeros(len(p), bool), seen_reference=np.ones((4, 3))
    )
    assert metrics.scores[0].precision == 0.0
    assert metrics.note is not None


def test_empty_reference_and_broken_vertices_are_errors():
    with pytest.raises(DataError, match="reference"):
        score(plate(1.0), EMPTY, samples=100)
    broken = Mesh(
        np.array([[0, 0, 0], [1, 0, 0], [0, float("nan"), 0]], dtype="float32"), np.array([[0, 1, 2]], dtype="int32")
    )
    with pytest.raises(DataError, match="not finite"):
        score(broken, plate(1.0), samples=100)


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="thresholds"):
        score(plate(1.0), plate(1.0), thresholds_m=(0.0,))
    with pytest.raises(ValueError, match="samples"):
        score(plate(1.0), plate(1.0), samples=0)


def test_score_counts_distances_below_the_threshold():
    score = score_at(0.05, np.array([0.01, 0.04, 0.05, 0.2]), np.array([0.01, 0.0, 0.0, 0.3]))
    assert (score.precision, score.recall) == (0.5, 0.75)
    assert score.f_score == pytest.approx(0.6)


def test_error_colours_follow_the_distance():
    strip = np.linspace(0.0, 0.1, 4).astype("float32")
    ramp = Mesh(
        np.array(
            [[0.3, 0.3, strip[0]], [0.5, 0.3, strip[1]], [0.3, 0.5, strip[2]], [0.5, 0.5, strip[3]]], dtype="float32"
        ),
        np.array([[0, 1, 2], [1, 3, 2]], dtype="int32"),
    )
    colors = color_by_distance(ramp, plate(1.0), 0.05).colors
    expected = matplotlib.colormaps["turbo"](np.array([0.0, 2 / 3, 1.0, 1.0]))[:, :3] * 255
    np.testing.assert_allclose(colors, expected, atol=3)


def test_distances_of_every_sample_between_spheres():
    accuracy, completeness = standard_distances(sphere(2.0), sphere(1.0), 1000, 0, "surface")
    np.testing.assert_allclose(accuracy, np.full(1000, 1.0), atol=0.01)
    np.testing.assert_allclose(completeness, np.full(1000, 1.0), atol=0.01)
