"""Cameras that lie far from all others."""

import numpy as np
import pytest
from uncle.recon.core.far_frames import describe_far_frames, far_frames


def path(count: int, step_m: float = 0.05, start: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    return np.array(start) + np.outer(np.arange(count) * step_m, [1.0, 0.0, 0.0])


@pytest.mark.parametrize(("away_m", "words"), [(50.0, "50 m"), (1000.0, "1000 m"), (100_000.0, "100 km")])
def test_one_frame_far_away_is_named_with_its_distance(away_m, words):
    positions = path(14)
    positions[7, 1] += away_m
    groups = far_frames(positions)
    assert [group.indices for group in groups] == [(7,)]
    assert groups[0].distance_m == pytest.approx(away_m, rel=1e-3)
    text = describe_far_frames(groups, range(100, 114))
    assert f"frame 107: {words}" in text


def test_a_group_of_frames_is_named_once():
    positions = np.concatenate([path(30), path(5, start=(0, 300, 0)), path(30)])
    groups = far_frames(positions)
    assert [group.indices for group in groups] == [tuple(range(30, 35))]
    assert "5 frames from 30 to 34: 300 m" in describe_far_frames(groups, range(65))


@pytest.mark.parametrize(
    "positions",
    [path(1), path(300), path(100, step_m=2.0), path(40, step_m=30.0), np.zeros((50, 3)), np.zeros((0, 3))],
    ids=["one frame", "a room", "a corridor of 200 m", "few frames over a long way", "in one place", "no frame"],
)
def test_usual_recordings_have_no_far_frame(positions):
    assert far_frames(positions) == []
    assert describe_far_frames([], []) == ""


def test_the_largest_group_is_the_one_that_others_are_far_from():
    positions = np.concatenate([path(3, start=(1e5, 0, 0)), path(50), path(2, start=(0, 0, 90))])
    assert [group.indices for group in far_frames(positions)] == [(0, 1, 2), (53, 54)]
