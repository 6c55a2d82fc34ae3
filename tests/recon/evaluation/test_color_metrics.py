"""Colour of held-out frames: painted walls with known differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.core.mesh import Mesh
from uncle.recon.evaluation.color_metrics import MIN_SQUARED_ERROR, held_out_color


def painted(mesh: Mesh, colors: np.ndarray) -> Mesh:
    return replace(mesh, colors=np.broadcast_to(colors, mesh.vertices.shape).astype(np.uint8))


def test_a_uniform_difference_of_ten_steps(box_room):
    mesh, pose = painted(box_room.mesh(), np.array([100, 120, 140])), box_room.pose(0.0)
    shown = np.broadcast_to(np.array([110, 110, 150], np.uint8), (120, 160, 3))
    metrics = held_out_color(mesh, box_room.camera, [(pose, shown)] * 2)
    assert metrics.psnr_db == pytest.approx(-20 * np.log10(10 / 255), abs=1e-4)
    assert metrics.l1 == pytest.approx(10 / 255, abs=1e-6)
    assert (metrics.completeness, metrics.frames) == (1.0, 2)


def test_colours_are_interpolated_between_vertices(box_room):
    """Painted by where they are, walls show at each pixel where its ray meets them."""
    mesh, pose = box_room.mesh(), box_room.pose(0.7)
    low, size = mesh.vertices.min(0), np.ptp(mesh.vertices, axis=0)
    colored = painted(mesh, np.round(255 * (mesh.vertices - low) / size))
    points = box_room.camera.rays().numpy() * box_room.depth(pose)[..., None] @ pose[:3, :3].T + pose[:3, 3]
    shown = np.round(255 * (points - low) / size).astype(np.uint8)
    metrics = held_out_color(colored, box_room.camera, [(pose, shown)])
    assert metrics.l1 < 0.3 / 255  # rounding alone leaves a quarter of a step
    assert metrics.psnr_db > 55


def test_mean_of_the_frames_is_that_of_their_decibels(box_room):
    mesh, pose = painted(box_room.mesh(), np.array([100, 100, 100])), box_room.pose(0.0)
    frames = [(pose, np.full((120, 160, 3), value, np.uint8)) for value in (101, 200)]
    expected = -10 * np.mean([np.log10((1 / 255) ** 2), np.log10((100 / 255) ** 2)])
    assert held_out_color(mesh, box_room.camera, frames).psnr_db == pytest.approx(expected, abs=1e-4)


def test_the_same_colours_have_the_decibels_of_rounding(box_room):
    mesh, shown = painted(box_room.mesh(), np.array([7, 8, 9])), np.full((120, 160, 3), (7, 8, 9), np.uint8)
    metrics = held_out_color(mesh, box_room.camera, [(box_room.pose(0.0), shown)])
    assert metrics.psnr_db == pytest.approx(-10 * np.log10(MIN_SQUARED_ERROR))


def test_what_the_mesh_lacks_is_stated(box_room):
    mesh, pose = painted(box_room.mesh(), np.array([1, 2, 3])), box_room.pose(0.0)
    shown = np.full((120, 160, 3), (1, 2, 3), np.uint8)
    partial = held_out_color(replace(mesh, faces=mesh.faces[:-2]), box_room.camera, [(pose, shown)])
    assert 0.0 < partial.completeness < 0.8
    assert partial.l1 == pytest.approx(0.0, abs=1e-7)
    nothing = held_out_color(replace(mesh, faces=mesh.faces[:0]), box_room.camera, [(pose, shown)])
    assert (nothing.psnr_db, nothing.l1, nothing.completeness, nothing.frames) == (None, None, 0.0, 1)
    assert held_out_color(mesh, box_room.camera, []).frames == 0


def test_a_mesh_without_colours(box_room):
    with pytest.raises(DataError, match="colours"):
        held_out_color(box_room.mesh(), box_room.camera, [])
    with pytest.raises(DataError, match="colours"):  # what is written where no colour was seen
        held_out_color(painted(box_room.mesh(), np.array([128, 128, 128])), box_room.camera, [])
