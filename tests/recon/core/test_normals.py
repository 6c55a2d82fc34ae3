"""Features on surfaces whose normals are known."""

import numpy as np
import pytest
from uncle.recon.core import normals as features
from uncle.recon.core.camera import Camera
from uncle.recon.methods.nice import published_normals as features_reference

CAMERA = Camera(96, 72, 80.0, 82.0, 46.5, 36.25)


def rays() -> np.ndarray:
    return CAMERA.rays().numpy().astype(np.float64)


def plane(normal: tuple[float, float, float], distance: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the plane `normal . X = -distance` and its unit normal towards the camera."""
    unit = np.array(normal) / np.linalg.norm(normal)
    return (-distance / (rays() @ unit)).astype(np.float32), unit


def sphere(centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Depth (0 beside the sphere) and the true normals towards the camera."""
    along, squared = rays() @ centre, (rays() ** 2).sum(-1)
    inside = along**2 - squared * (centre @ centre - radius**2)
    depth = np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / squared, 0)
    return depth.astype(np.float32), (rays() * depth[..., None] - centre) / radius * (depth > 0)[..., None]


def angles(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip((found * truth).sum(-1), -1, 1)))


PLANES = [(0, 0, -1), (1, 0, -1), (0, -2, -1), (0.7, 1.2, -1)]


@pytest.mark.parametrize("normal", PLANES)
def test_normals_of_a_plane_are_exact_up_to_the_border(normal):
    depth, truth = plane(normal, 2.0)
    visible = (depth > 0) & (depth < 20)
    found = features.normals(features.smooth_depth(np.where(visible, depth, 0)), CAMERA)
    known = found.any(-1)
    assert known[visible].mean() > 0.98
    assert not found[~visible].any()
    assert np.quantile(angles(found, truth)[known], 0.99) < 1.0


def test_normals_of_a_sphere():
    depth, truth = sphere(np.array([0.1, -0.05, 2.0]), 0.9)
    found = features.normals(features.smooth_depth(depth), CAMERA)
    facing = -(truth * rays() / np.linalg.norm(rays(), axis=-1, keepdims=True)).sum(-1) > 0.4
    assert found[facing].any(-1).all()
    assert np.median(angles(found, truth)[facing]) < 1.0
    assert angles(found, truth)[facing].max() < 6.0
    assert not found[depth == 0].any()


def test_normals_are_unit_and_face_the_camera():
    rng = np.random.default_rng(0)
    depth = rng.uniform(0.5, 4, (CAMERA.height, CAMERA.width)).astype(np.float32)
    depth[rng.random(depth.shape) < 0.2] = 0
    found = features.normals(depth, CAMERA)
    known = found.any(-1)
    np.testing.assert_allclose(np.linalg.norm(found[known], axis=-1), 1, atol=1e-5)
    assert ((found * rays()).sum(-1)[known] < 0).all()


def test_normals_beside_holes_and_edges_are_those_of_the_own_surface():
    near, near_normal = plane((0.4, 0.2, -1), 1.0)
    far, far_normal = plane((-0.3, 0, -1), 3.0)
    left = np.arange(CAMERA.width)[None] < 40
    depth = np.where(left, near, far).astype(np.float32)
    depth[20:30, 30:50] = 0
    depth[50, 60] = 0
    found = features.normals(features.smooth_depth(depth), CAMERA)
    valid = depth > 0
    assert found[valid].any(-1).mean() > 0.995
    known = found.any(-1)
    assert angles(found, np.where(left[..., None], near_normal, far_normal))[known].max() < 1.0
    assert not known[~valid].any()


def test_a_pixel_without_neighbours_has_no_normal():
    depth = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    depth[30, 30] = 2.0
    assert not features.normals(features.smooth_depth(depth), CAMERA).any()


def test_nothing_wraps_around_the_image():
    depth, _ = plane((0.5, 0, -1), 2.0)
    changed = depth.copy()
    changed[:, -1] = 9.0
    for function in (features.smooth_depth, lambda image: features.normals(image, CAMERA)):
        np.testing.assert_array_equal(function(depth)[:, :8], function(changed)[:, :8])


def test_smoothing_removes_noise_and_keeps_steps_and_holes():
    rng = np.random.default_rng(1)
    truth = np.where(np.arange(CAMERA.width)[None] < 48, 2.0, 2.6) * np.ones((CAMERA.height, 1))
    depth = (truth + rng.normal(0, 0.01, truth.shape)).astype(np.float32)
    depth[10:14, 40:60] = 0
    smooth = features.smooth_depth(depth)
    valid = depth > 0
    assert (smooth[~valid] == 0).all()
    interior = valid.copy()
    interior[:4] = interior[-4:] = interior[:, :4] = interior[:, -4:] = False
    error, before = (smooth - truth)[interior], (depth - truth)[interior]
    assert error.std() < 0.5 * before.std()
    columns = np.abs((smooth - truth)[:, 46:50])[valid[:, 46:50]]
    assert columns.max() < 0.05  # the step of 60 cm leaves no trace


def test_smoothing_keeps_planes_however_steep():
    depth, _ = plane((1.5, 0, -1), 1.5)
    depth[(depth < 0) | (depth > 10)] = 0
    np.testing.assert_allclose(features.smooth_depth(depth), depth, rtol=1e-4)


def test_a_wide_range_blurs_what_a_narrow_one_keeps():
    depth = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    depth[:, 48:] = 2.2
    narrow, wide = features.smooth_depth(depth, 0.005), features.smooth_depth(depth, 1.0)
    np.testing.assert_allclose(narrow, depth, atol=1e-5)
    assert np.abs(wide - depth).max() > 0.02


def test_incidence_is_the_cosine_between_sight_and_normal():
    depth, truth = plane((0.6, 0, -1), 2.0)
    found = features.incidence(features.normals(depth, CAMERA), CAMERA)
    unit = rays() / np.linalg.norm(rays(), axis=-1, keepdims=True)
    np.testing.assert_allclose(found, -(unit @ truth), atol=2e-3)
    assert (features.incidence(np.zeros((*depth.shape, 3), np.float32), CAMERA) == 0).all()


def test_gradients_read_one_on_a_unit_slope_and_nothing_beside_holes():
    x, y = np.meshgrid(np.arange(20, dtype=np.float32), np.arange(15, dtype=np.float32))
    depth = 5 + x - 0.25 * y
    depth[7, 9] = 0
    dx, dy = features.gradients(depth)
    known = dx != 0
    assert known.sum() == 13 * 18 - 9
    assert not known[6:9, 8:11].any()
    np.testing.assert_allclose(dx[known], 1, atol=1e-5)
    np.testing.assert_allclose(dy[known], -0.25, atol=1e-5)


def slow_bilateral(depth: np.ndarray, v: int, u: int) -> float:
    """The definition, at one pixel far from the border: a disc of radius 4, both kernels Gaussian."""
    total = weight = 0.0
    for y in range(-4, 5):
        for x in range(-4, 5):
            if x * x + y * y <= 16:
                value = float(depth[v + y, u + x])
                w = np.exp(-(x * x + y * y) / (2 * 9.0**2) - (value - float(depth[v, u])) ** 2 / (2 * 100.0**2))
                total, weight = total + w * value, weight + w
    return total / weight


def test_reference_features_follow_their_formulas():
    rng = np.random.default_rng(2)
    depth = rng.uniform(1, 3, (CAMERA.height, CAMERA.width)).astype(np.float32)
    depth[30:33, 40:44] = 0
    smooth = features_reference.smooth_depth(depth)
    for v, u in [(20, 30), (31, 39), (50, 80)]:
        assert smooth[v, u] == pytest.approx(slow_bilateral(depth, v, u), rel=1e-4)
    found = features_reference.normals(smooth, CAMERA)
    for v, u in [(1, 1), (31, 41), (70, 94)]:
        point, right, below = (
            np.array([(b - CAMERA.cx) / CAMERA.fx, (a - CAMERA.cy) / CAMERA.fy, 1.0]) * smooth[a, b]
            for a, b in [(v, u), (v, u + 1), (v + 1, u)]
        )
        normal = np.cross(right - point, below - point)
        np.testing.assert_allclose(found[v, u], normal / np.linalg.norm(normal), atol=1e-4)
    border = np.ones(depth.shape, bool)
    border[1:-1, 1:-1] = False
    assert not found[border].any()


def test_reference_normals_point_away_and_its_slope_reads_128_over_48():
    flat = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    away = features_reference.normals(flat, CAMERA)
    np.testing.assert_allclose(away[1:-1, 1:-1] @ [0, 0, 1], 1, atol=1e-5)
    assert features_reference.incidence(away, CAMERA)[36, 46] > 0.999
    x, _ = np.meshgrid(np.arange(20, dtype=np.float32), np.arange(15))
    dx, dy = features_reference.gradients(5 + x)
    np.testing.assert_allclose(dx[2:-2, 2:-2], 128 / 48, rtol=1e-5)
    np.testing.assert_allclose(dy, 0, atol=1e-5)
