"""Scores of the sigma of vertices on a plane whose errors are known."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from uncle.recon.core.errors import DataError
from uncle.recon.core.mesh import Mesh
from uncle.recon.evaluation.vertex_sigma_metrics import MEDIAN_IN_SIGMAS, evaluate_vertex_sigma, score_vertex_sigma

SIDE = 200
FLOOR = Mesh(
    np.array([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], np.float32), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
)


@pytest.fixture(scope="module")
def sheet() -> Mesh:
    """Vertices off the floor by a Gaussian error whose sigma, 2 mm to 2 cm, they state."""
    rng = np.random.default_rng(0)
    x, y = (axis.ravel() for axis in np.meshgrid(np.linspace(-4, 4, SIDE), np.linspace(-4, 4, SIDE)))
    sigma = np.exp(rng.uniform(np.log(0.002), np.log(0.02), len(x)))
    corner = (np.arange(SIDE - 1) + SIDE * np.arange(SIDE - 1)[:, None]).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, SIDE + 1], corner[:, None] + [0, SIDE + 1, SIDE]])
    vertices = np.column_stack([x, y, rng.normal(0, sigma)])
    return Mesh(vertices.astype(np.float32), faces.astype(np.int32), None, sigma.astype(np.float32))


def test_a_true_sigma_covers_what_it_states(sheet):
    metrics = evaluate_vertex_sigma(sheet, FLOOR)
    assert metrics.vertices == SIDE * SIDE
    assert metrics.coverage_1_sigma == pytest.approx(0.6827, abs=0.01)
    assert metrics.coverage_2_sigma == pytest.approx(0.9545, abs=0.005)
    assert metrics.median_in_sigmas == pytest.approx(0.6745, abs=0.01)
    assert metrics.sigma_factor == pytest.approx(1.0, abs=0.02)
    np.testing.assert_allclose(metrics.curves.empirical, metrics.curves.nominal, atol=0.01)
    np.testing.assert_allclose(metrics.curves.bin_distance_rms_m, metrics.curves.bin_sigma_m, rtol=0.1)
    assert 0.0 < metrics.ause < 0.8 * metrics.ause_random
    found = stats.spearmanr(sheet.sigma, np.abs(sheet.vertices[:, 2])).statistic
    assert metrics.rank_correlation == pytest.approx(found, abs=1e-3)


def test_a_rash_sigma_is_found_out(sheet):
    metrics = evaluate_vertex_sigma(replace(sheet, sigma=sheet.sigma / 2), FLOOR)
    assert metrics.sigma_factor == pytest.approx(2.0, rel=0.03)
    assert metrics.coverage_1_sigma == pytest.approx(2 * stats.norm.cdf(0.5) - 1, abs=0.01)
    assert metrics.coverage_2_sigma == pytest.approx(0.6827, abs=0.01)


def test_only_visible_vertices_of_triangles_count(sheet):
    right = evaluate_vertex_sigma(sheet, FLOOR, lambda points: points[:, 0] > 0)
    assert right.vertices == SIDE * SIDE // 2
    loose = np.array([[0, 0, 5]], np.float32)
    more = replace(sheet, vertices=np.concatenate([sheet.vertices, loose]), sigma=np.append(sheet.sigma, 1))
    assert evaluate_vertex_sigma(more, FLOOR) == evaluate_vertex_sigma(sheet, FLOOR)


def test_hand_made_distances():
    metrics = score_vertex_sigma(np.array([0.0, 0.01, 0.03, 0.08]), np.array([0.01, 0.01, 0.02, 0.02]))
    assert (metrics.coverage_1_sigma, metrics.coverage_2_sigma) == (0.5, 0.75)
    assert metrics.median_in_sigmas == pytest.approx(1.25)
    assert metrics.sigma_factor == pytest.approx(1.25 / 0.67449, rel=1e-4)
    assert pytest.approx(0.67449, abs=1e-5) == MEDIAN_IN_SIGMAS
    assert score_vertex_sigma(np.array([0.0, 0.01]), np.full(2, 0.01)).rank_correlation is None
    oracle = np.linspace(0.01, 0.05, 50)
    assert score_vertex_sigma(oracle, oracle).ause == pytest.approx(0.0, abs=1e-12)


def test_what_cannot_be_scored_says_why(sheet):
    with pytest.raises(DataError, match="have no sigma"):
        evaluate_vertex_sigma(FLOOR, FLOOR)
    with pytest.raises(DataError, match="no vertex"):
        evaluate_vertex_sigma(sheet, FLOOR, lambda points: np.zeros(len(points), bool))
    empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), None, np.zeros(0, np.float32))
    with pytest.raises(DataError, match="no vertex"):
        evaluate_vertex_sigma(empty, FLOOR)
    for broken in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(DataError, match="positive length"):
            evaluate_vertex_sigma(replace(sheet, sigma=np.full(len(sheet.vertices), broken, np.float32)), FLOOR)
    with pytest.raises(DataError, match="reference not empty"):
        evaluate_vertex_sigma(sheet, replace(empty, sigma=None))
