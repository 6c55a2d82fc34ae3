"""Depth by matching images of painted walls, from a map that is wrong by some percent."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.uncle import PhotometricConfig
from uncle.recon.mvs.cost_volume import GreyView
from uncle.recon.mvs.multi_view_consistency import cross_view_residual
from uncle.recon.mvs.plane_sweep import PHOTOMETRIC_INPUTS, PlaneSweepParameters, PlaneSweepView, plane_sweep_depth
from uncle.recon.mvs.view_selection import ViewSelectionParameters, choose_sources

CAMERA = Camera(80, 60, 60.0, 60.0, 39.5, 29.5)


@pytest.fixture(scope="module")
def poses(box_room) -> np.ndarray:
    """(10, 4, 4) from which the camera looks at one wall, 2.8 m away; the fifth is in the middle."""
    return np.array([box_room.pose(0.0, (1.6, y, z)) for y in (0.9, 1.2, 1.5, 1.8, 2.1) for z in (1.0, 1.4)])


def take_images(room, poses, blank_above_m: float = np.inf) -> list[GreyView]:
    pictures = [cv2.cvtColor(room.picture(pose, blank_above_m), cv2.COLOR_RGB2GRAY) for pose in poses]
    return [
        GreyView(i, grey.astype(np.float32), pose) for i, (grey, pose) in enumerate(zip(pictures, poses, strict=True))
    ]


def matched(room, poses, prior, **paint) -> PlaneSweepView:
    views, sources = take_images(room, poses, **paint), choose_sources(room.camera, poses, 4, 2.8)
    return plane_sweep_depth(room.camera, views[4], [views[s] for s in sources], prior.astype(np.float32))


def plane_view(index: int, distance_m: float, x_m: float = 0.0, wall_m: float = 3.0) -> PlaneSweepView:
    """A wall at z = wall_m, seen from x = x_m, measured `distance_m` away."""
    pose = np.eye(4)
    pose[0, 3], pose[2, 3] = x_m, wall_m - 2.0
    depth = np.full((60, 80), distance_m, np.float32)
    return PlaneSweepView(
        index, pose, depth, np.zeros_like(depth), np.zeros((60, 80, len(PHOTOMETRIC_INPUTS)), np.float16), ()
    )


# --- depth -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("wrong", [0.94, 1.0, 1.03, 1.06])
def test_finds_the_walls_from_a_map_that_is_off(box_room, poses, wrong):
    true = box_room.depth(poses[4])
    image = matched(box_room, poses, true * wrong)
    found = image.depth > 0
    off = np.abs(image.depth / true - 1)[found]
    assert found.mean() > 0.9
    assert np.median(off) < 0.002
    assert np.quantile(off, 0.9) < 0.01
    assert image.inputs.shape == (*true.shape, len(PHOTOMETRIC_INPUTS))
    assert np.isfinite(image.inputs).all()
    assert image.sources == tuple(choose_sources(box_room.camera, poses, 4, 2.8))


def test_a_map_that_is_off_by_a_ramp_and_has_holes(box_room, poses):
    true = box_room.depth(poses[4])
    prior = true * np.linspace(0.95, 1.05, true.shape[1])
    prior[40:60, 50:90] = 0
    image = matched(box_room, poses, prior)
    assert not image.depth[40:60, 50:90].any()
    found = image.depth > 0
    assert np.median(np.abs(image.depth / true - 1)[found]) < 0.002


def test_beyond_the_search_band_the_inputs_show_a_bad_match(box_room, poses):
    """Off by more than the search: the result is no surface, which the inputs of the noise model reveal."""
    true = box_room.depth(poses[4])
    near, far = matched(box_room, poses, true), matched(box_room, poses, true * 1.4)
    zncc, offset = PHOTOMETRIC_INPUTS.index("zncc"), PHOTOMETRIC_INPUTS.index("offset")
    assert np.median(far.inputs[..., zncc]) < np.median(near.inputs[..., zncc]) - 0.2
    assert np.median(far.inputs[..., offset]) > np.median(near.inputs[..., offset]) + 0.2


def test_a_wall_without_paint_has_no_depth(box_room, poses):
    true = box_room.depth(poses[4])
    height = poses[4][2, 3] + (box_room.camera.rays().numpy() @ poses[4][:3, :3].T)[..., 2] * true
    image = matched(box_room, poses, true * 1.04, blank_above_m=1.25)
    assert (height > 1.6).any()
    assert not image.depth[height > 1.6].any()
    assert (image.depth[height < 0.9] > 0).mean() > 0.9


@pytest.mark.parametrize("level", [0, 137, 251, 255])
def test_flat_pictures_have_no_depth(box_room, poses, level):
    """Not even by rounding."""
    flat = [GreyView(i, np.full((120, 160), level, np.float32), pose) for i, pose in enumerate(poses)]
    prior = box_room.depth(poses[4]).astype(np.float32)
    assert not plane_sweep_depth(box_room.camera, flat[4], flat[:3], prior).depth.any()


def test_without_a_prior_there_is_no_depth(box_room, poses):
    assert not matched(box_room, poses, np.zeros((120, 160))).depth.any()


# --- sources -----------------------------------------------------------------------------------------------------
def test_sources_overlap_and_see_from_elsewhere(box_room):
    where = {
        "reference": box_room.pose(0.0, (1.6, 1.5, 1.2)),
        "same place": box_room.pose(0.0, (1.6, 1.5, 1.2)),
        "barely moved": box_room.pose(0.0, (1.6, 1.52, 1.2)),
        "beside": box_room.pose(0.0, (1.6, 2.0, 1.2)),
        "beside, turned away": box_room.pose(np.pi, (1.6, 2.0, 1.2)),
        "turned on the spot": box_room.pose(0.5, (1.6, 1.5, 1.2)),
        "far": box_room.pose(0.0, (1.6, 4.5, 1.2)),
        "above": box_room.pose(0.0, (1.6, 1.5, 1.6)),
        "above, again": box_room.pose(0.0, (1.6, 1.5, 1.61)),
    }
    where["turned on the spot"][:3, 3] = where["reference"][:3, 3]
    chosen = choose_sources(box_room.camera, np.array(list(where.values())), 0, 2.8)
    names = {list(where)[row] for row in chosen}
    assert names - {"above", "above, again"} == {"beside"}
    assert len(chosen) == 2  # one of two that are nearly the same


def test_no_more_sources_than_needed_and_the_best_first(box_room):
    poses = np.array([box_room.pose(0.0, (1.6, 1.5 + y, 1.2)) for y in np.linspace(-1.0, 1.0, 41)])
    chosen = choose_sources(box_room.camera, poses, 20, 2.8)
    assert len(chosen) == ViewSelectionParameters.max_sources
    shift = np.abs(poses[chosen, 1, 3] - 1.5)
    assert (shift > 0.06 * 2.8 * 0.99).all()
    none = choose_sources(box_room.camera, np.repeat(poses[:1], 9, axis=0), 3, 2.8)
    assert none == []


# --- consistency -------------------------------------------------------------------------------------------------
def test_residual_is_the_median_distance_from_what_others_measure():
    off = [0.0, 0.01, -0.02, 0.05, 0.04]
    images = [plane_view(i, 2.0 + miss, 0.05 * i) for i, miss in enumerate(off)]
    pixels = np.array([60 * 40, 30 * 80 + 40])[1:]
    miss, count = cross_view_residual(CAMERA, images, 0, pixels)
    assert count.tolist() == [4]
    assert miss[0] == pytest.approx(0.02, abs=1e-6)  # the lower median of 1, 2, 4, 5 cm


def test_a_minority_behind_another_surface_is_left_out():
    images = [plane_view(i, 2.0, 0.05 * i) for i in range(5)]
    images += [plane_view(5 + i, 0.8, 0.05 * i) for i in range(3)]
    miss, count = cross_view_residual(CAMERA, images, 0, np.array([30 * 80 + 40]))
    assert count.tolist() == [7]
    assert miss[0] == pytest.approx(0.0, abs=1e-6)


def test_views_that_do_not_see_the_point_do_not_count():
    blind = plane_view(1, 0.0, 0.1)
    away = replace(plane_view(2, 2.0), T_world_camera=np.diag([-1.0, 1.0, -1.0, 1.0]))
    miss, count = cross_view_residual(CAMERA, [plane_view(0, 2.0), blind, away], 0, np.array([2040, 2041]))
    assert count.tolist() == [0, 0]
    assert np.isinf(miss).all()
    alone, count = cross_view_residual(CAMERA, [plane_view(0, 2.0)], 0, np.array([0]))
    assert np.isinf(alone).all()
    assert count.tolist() == [0]
    nothing, _ = cross_view_residual(CAMERA, [plane_view(0, 0.0), plane_view(1, 2.0)], 0, np.array([], np.int64))
    assert nothing.shape == (0,)


def test_defaults_of_settings_and_parameters_agree():
    assert PlaneSweepParameters.from_config(PhotometricConfig()) == PlaneSweepParameters()
    config = PhotometricConfig(window_px=7, search_px=6.0, step_px=0.25)
    parameters = PlaneSweepParameters.from_config(config)
    assert (parameters.cost.window_px, parameters.search_px, parameters.step_px) == (7, 6.0, 0.25)
    assert ViewSelectionParameters.max_sources == PhotometricConfig().max_sources
