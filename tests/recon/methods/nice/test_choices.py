"""Which frames and which features take part in a step; stages and step sizes."""

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.nice import NiceMappingConfig
from uncle.recon.methods.nice.frustum import in_frustum
from uncle.recon.methods.nice.keyframes import choose_window, mean_depth, overlapping_keyframes
from uncle.recon.methods.nice.mapper import learning_rates, schedule

CAMERA = Camera(160, 120, 90.0, 90.0, 79.5, 59.5)


@pytest.mark.parametrize(("iterations", "counts"), [(60, (25, 12, 23)), (1500, (601, 300, 599))])
def test_the_published_schedule(iterations, counts):
    stages = schedule(iterations, NiceMappingConfig(), released=True, color=True)
    assert tuple(stages.count(stage) for stage in ("middle", "fine", "color")) == counts
    assert stages == sorted(stages, key=["middle", "fine", "color"].index)


def test_the_paper_joins_fine_grid_and_colour_after_60_percent():
    stages = schedule(60, NiceMappingConfig(), released=False, color=True)
    assert [stages.count(stage) for stage in ("middle", "fine", "color")] == [37, 0, 23]
    assert schedule(60, NiceMappingConfig(), released=False, color=False).count("fine") == 23


def test_step_sizes():
    settings = NiceMappingConfig()
    middle, fine, color = (learning_rates(settings, stage, 5.0, "color") for stage in ("middle", "fine", "color"))
    assert middle == {"middle": 0.5, "fine": 0, "color": 0, "decoder": 0, "noise": 0, "poses": 0}
    assert fine == pytest.approx(
        {"middle": 0.025, "fine": 0.025, "color": 0, "decoder": 0.025, "noise": 0.0015, "poses": 0}
    )
    assert color == pytest.approx(fine | {"color": 0.025, "poses": 0.001})
    assert learning_rates(settings, "fine", 5.0, "fine")["poses"] == 0.001  # where no colour is mapped


def test_holes_do_not_count_in_the_mean_depth():
    depths = torch.tensor([[1.0, 0.0, 2.0], [3.0, 0.0, 0.0]])
    assert mean_depth(depths).tolist() == [2.0, 0.0, 2.0]


def test_keyframes_that_look_elsewhere_do_not_overlap(box_room):
    poses = [box_room.pose(angle) for angle in (0.0, 0.3, np.pi)]
    depths = torch.from_numpy(box_room.depth(poses[0])).float()[None]
    matrices = torch.from_numpy(np.array(poses)).float()
    seen = overlapping_keyframes(depths, matrices[0], matrices, CAMERA, torch.Generator().manual_seed(0))
    assert sorted(seen) == [0, 1]
    assert overlapping_keyframes(depths, matrices[0], matrices[:0], CAMERA, torch.Generator()) == []


def test_the_newest_keyframe_is_always_in_the_window():
    assert choose_window([3, 0, 4, 2], 5, 4) == [3, 0, 4]
    assert choose_window([1], 5, 4) == [1, 4]
    assert choose_window([], 0, 4) == []


def test_features_before_a_wall_and_half_a_metre_behind_it_may_change():
    depths = torch.full((1, 120, 160), 2.0)
    depths[0, :, 80:] = 0.0  # no reading: up to the farthest one
    pose = torch.eye(4)
    pose[0, 3] = 10.0
    points = torch.tensor([[0.0, 0.0, 1.0], [-0.2, 0.0, 2.4], [-0.2, 0.0, 2.6], [0.2, 0.0, 2.4], [0.2, 0.0, 2.6],
                           [5.0, 0.0, 1.0], [0.0, 0.0, -0.4], [0.0, 0.0, -0.6]])  # fmt: skip
    wanted = [True, True, False, True, False, False, True, False]
    assert in_frustum(points + pose[:3, 3], depths, pose, CAMERA).tolist() == wanted
    farther = torch.cat([depths, torch.full((1, 120, 160), 3.0)])
    assert in_frustum(points + pose[:3, 3], farther, pose, CAMERA)[2]
