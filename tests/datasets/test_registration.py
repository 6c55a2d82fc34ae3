"""Colour seen from a second camera, against the colour that the depth camera itself would see."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from uncle.datasets.registration import TYPICAL_DEPTH_M, ColorRegistration, filled_inverse_depth
from uncle.recon.core.camera import Camera

DEPTH_CAMERA = Camera(320, 240, 290.0, 292.0, 161.0, 118.0)
COLOR_CAMERA = Camera(320, 240, 262.0, 260.0, 158.0, 122.0)
T_COLOR_DEPTH = np.eye(4)
T_COLOR_DEPTH[:3, :3] = Rotation.from_rotvec([0.01, -0.02, 0.015]).as_matrix()
T_COLOR_DEPTH[:3, 3] = [-0.06, 0.01, 0.005]
PLANE = np.array([0.12, 0.08, -0.4])  # inverse depth in the depth camera's axes: n . x = -1
BOX_LOW, BOX_HIGH = np.array([-0.25, -0.2, 1.2]), np.array([0.2, 0.15, 1.6])


def render(camera: Camera, T_camera_scene: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 3) uint8 colour and (H, W) float32 z-depth of a slanted plane behind a box."""
    pose = np.linalg.inv(T_camera_scene)
    directions = camera.rays().numpy().astype(np.float64) @ pose[:3, :3].T
    origin = pose[:3, 3]
    depth = (-1 - PLANE @ origin) / (directions @ PLANE)
    directions = np.where(directions == 0, 1e-12, directions)
    first, second = (BOX_LOW - origin) / directions, (BOX_HIGH - origin) / directions
    enters, leaves = np.minimum(first, second).max(-1), np.maximum(first, second).min(-1)
    depth = np.where(enters < leaves, np.minimum(depth, enters), depth)
    points = origin + directions * depth[..., None]
    waves = np.sin(points @ np.array([[17.0, 5, 9], [4, 21, -7], [-6, 8, 13]]).T + [0, 1, 2])
    return np.round(127.5 + 120 * waves).astype(np.uint8), depth.astype(np.float32)


def far_from_edges(depth: np.ndarray, pixels: int = 9) -> np.ndarray:
    """(H, W) bool: no depth edge, and so nothing hidden from the other camera, within `pixels`; nor the border."""
    kernel = np.ones((2 * pixels + 1,) * 2, np.uint8)
    inner = np.pad(np.ones(tuple(n - 40 for n in depth.shape), bool), 20)
    return (cv2.dilate(depth, kernel) / cv2.erode(depth, kernel) < 1.2) & inner


def error(color: np.ndarray, expected: np.ndarray, where: np.ndarray) -> float:
    """Mean difference in levels of colour."""
    return float(np.abs(color[where].astype(float) - expected[where]).mean())


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The other camera's colour, the depth, the colour that the depth camera would see, where to compare."""
    expected, depth = render(DEPTH_CAMERA, np.eye(4))
    return render(COLOR_CAMERA, T_COLOR_DEPTH)[0], depth, expected, far_from_edges(depth)


def test_colour_is_that_of_the_depth_camera(scene):
    color, depth, expected, where = scene
    assert where[depth < 1.7].sum() > 1000  # the box takes part
    assert where.mean() > 0.3
    assert error(ColorRegistration(COLOR_CAMERA, T_COLOR_DEPTH, DEPTH_CAMERA)(color, depth), expected, where) < 0.6
    inverse = ColorRegistration(COLOR_CAMERA, np.linalg.inv(T_COLOR_DEPTH), DEPTH_CAMERA)(color, depth)
    assert min(error(color, expected, where), error(inverse, expected, where)) > 20


@pytest.mark.parametrize("size", [(640, 480), (1280, 720), (120, 90)])
def test_colour_may_have_another_size(scene, size):
    _, depth, expected, where = scene
    camera = Camera(*size, 0.60 * size[0], 0.61 * size[0], size[0] / 2 + 3, size[1] / 2 - 2)
    color, _ = render(camera, T_COLOR_DEPTH)
    registered = ColorRegistration(camera, T_COLOR_DEPTH, DEPTH_CAMERA)(color, depth)
    assert registered.shape == expected.shape
    assert error(registered, expected, where) < (0.8 if size[0] > 320 else 3.0)


def test_fine_texture_of_fine_colour_does_not_alias():
    camera = Camera(1280, 960, 1160.0, 1160.0, 640.0, 480.0)
    stripes = np.zeros((960, 1280, 3), np.uint8)
    stripes[:, ::2] = 200
    even = ColorRegistration(camera, np.eye(4), DEPTH_CAMERA)(stripes, np.ones((240, 320), np.float32))
    assert np.abs(even[20:-20, 20:-20].astype(int) - 100).max() <= 4


def test_one_camera_leaves_colour_as_it_is(scene):
    color, depth, _, _ = scene
    registered = ColorRegistration(DEPTH_CAMERA, np.eye(4), DEPTH_CAMERA)(color, depth)
    np.testing.assert_array_equal(registered, color)


def test_holes_and_flickering_readings_cost_little(scene):
    color, depth, expected, where = scene
    rng = np.random.default_rng(0)
    holed = np.where(rng.random(depth.shape) < 0.3, 0, depth * rng.normal(1, 0.01, depth.shape)).astype(np.float32)
    holed[100:130, 200:280] = 0
    registered = ColorRegistration(COLOR_CAMERA, T_COLOR_DEPTH, DEPTH_CAMERA)(color, holed)
    assert error(registered, expected, where) < 3.0


def test_shadow_beside_a_near_thing_is_background(scene):
    depth = scene[1]
    near = depth < 1.7
    shadow = cv2.dilate(near.astype(np.uint8), np.ones((1, 31)), anchor=(30, 0)).astype(bool) & ~near
    assert shadow.sum() > 2000
    filled = 1 / filled_inverse_depth(np.where(shadow, 0, depth).astype(np.float32))
    np.testing.assert_allclose(filled[shadow], depth[shadow], rtol=0.15)  # the box is 1.5 times as near
    np.testing.assert_allclose(filled[~shadow], depth[~shadow], rtol=1e-6)


def test_row_without_a_reading_takes_the_mean_of_the_image():
    depth = np.array([[0.0, 2.0, 0.0, 4.0], [0.0, 0.0, 0.0, 0.0]], np.float32)
    np.testing.assert_allclose(filled_inverse_depth(depth), [[0.5, 0.5, 0.25, 0.25], [0.375] * 4])


def test_no_reading_at_all_is_a_typical_depth(scene):
    color, depth, _, _ = scene
    registration = ColorRegistration(COLOR_CAMERA, T_COLOR_DEPTH, DEPTH_CAMERA)
    typical = registration(color, np.full_like(depth, TYPICAL_DEPTH_M))
    np.testing.assert_array_equal(registration(color, np.zeros_like(depth)), typical)


def test_pixels_outside_the_colour_image_repeat_its_border():
    small = Camera(160, 120, 262.0, 260.0, 80.0, 60.0)
    color = np.full((120, 160, 3), 90, np.uint8)
    registered = ColorRegistration(small, T_COLOR_DEPTH, DEPTH_CAMERA)(color, np.full((240, 320), 2.0, np.float32))
    assert (registered == 90).all()


def test_surface_behind_the_colour_camera_is_no_trouble():
    T = np.eye(4)
    T[2, 3] = -0.9
    depth = np.full((240, 320), 0.5, np.float32)
    color = np.full((240, 320, 3), 7, np.uint8)
    assert (ColorRegistration(COLOR_CAMERA, T, DEPTH_CAMERA)(color, depth) == 7).all()
