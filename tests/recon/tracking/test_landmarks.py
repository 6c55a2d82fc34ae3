"""Tables of points, and who saw them."""

from dataclasses import replace

import numpy as np
from uncle.recon.tracking.landmarks import (
    NONE,
    FrameFeatures,
    Landmarks,
    observations_of,
    pixel_information_factor,
    seen_at_least,
)


def frame_features(index: int, *landmarks: int) -> FrameFeatures:
    """A frame whose features tell in their pixels which frame and feature they are."""
    count = len(landmarks)
    number = np.arange(count)
    return FrameFeatures(
        index, np.eye(4), np.column_stack([np.full(count, 100.0 * index), number]), np.ones(count),
        np.tile([2.0, 0.0], (count, 1)), np.full((count, 2), 0.1), np.zeros((count, 2)),
        np.zeros((count, 2, 3), np.float32), np.array(landmarks, np.int64),
    )  # fmt: skip


def landmarks(count: int) -> Landmarks:
    made = Landmarks()
    made.add(np.arange(3.0 * count).reshape(-1, 3), np.eye(count, 128, dtype=np.float32))
    return made


def test_landmarks_are_numbered_in_order():
    made = landmarks(3)
    assert made.add(np.ones((2, 3)), np.zeros((2, 128), np.float32)).tolist() == [3, 4]
    assert len(made) == 5
    assert made.current(np.array([4, NONE, 0])).tolist() == [4, NONE, 0]


def test_merged_landmarks_live_on_under_one_number():
    made = landmarks(6)
    made.merge(np.array([4]), np.array([1]))
    made.merge(np.array([1, 5]), np.array([0, 4]))  # chains
    assert made.current(np.arange(6)).tolist() == [0, 0, 2, 3, 0, 0]
    made.merge(np.array([4]), np.array([5]))  # already the same
    assert made.current(np.array([NONE, 5])).tolist() == [NONE, 0]
    assert Landmarks().current(np.array([NONE, NONE])).tolist() == [NONE, NONE]


def test_seen_by_is_distinct_and_without_none():
    made = landmarks(6)
    made.merge(np.array([5]), np.array([1]))
    assert made.seen_by(frame_features(0, 5, NONE, 3, 1)).tolist() == [1, 3]


def test_observations_see_a_point_once_in_an_image():
    made = landmarks(6)
    made.merge(np.array([5]), np.array([1]))
    seen, numbers = observations_of([frame_features(0, 4, NONE, 1, 5), frame_features(7, 5, 2, NONE)], made)
    assert numbers.tolist() == [1, 2, 4]
    found = set(zip(seen.camera.tolist(), numbers[seen.point].tolist(), map(tuple, seen.uv.tolist()), strict=True))
    assert found == {(0, 4, (0.0, 0.0)), (0, 1, (0.0, 2.0)), (1, 1, (700.0, 0.0)), (1, 2, (700.0, 1.0))}
    assert seen_at_least(seen, 2).tolist() == (numbers[seen.point] == 1).tolist()
    assert not seen_at_least(seen, 3).any()
    none, numbers = observations_of([frame_features(0, NONE)], made)
    assert len(none) == len(numbers) == len(seen_at_least(none, 2)) == 0


def test_mean_depth_is_by_certainty():
    frame = frame_features(0, 0, 1, 2)
    frame.depths[:] = [[2.0, 3.0], [0.0, 3.0], [0.0, 0.0]]
    frame.sigmas_m[:] = [[0.1, 0.2], [0.1, 0.2], [0.1, 0.2]]
    depth, sigma = frame.mean_depth()
    np.testing.assert_allclose(depth, [2.2, 3.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(sigma[:2], [1 / np.sqrt(125), 0.2])
    assert sigma[2] > 1e3


def test_forget_unmatched_keeps_rows_whole():
    frame = frame_features(3, NONE, 8, NONE, 6)
    frame.forget_unmatched()
    assert len(frame) == 2
    assert frame.landmark.tolist() == [8, 6]
    assert frame.uv[:, 1].tolist() == [1.0, 3.0]
    assert {len(v) for k, v in vars(frame).items() if k not in ("index", "pose", "common_px")} == {2}


def test_state_round_trip():
    frame = frame_features(3, NONE, 8)
    again = FrameFeatures.from_state(frame.to_state())
    assert again.index == 3
    for name, value in vars(frame).items():
        np.testing.assert_array_equal(getattr(again, name), value)


def test_pixels_that_are_off_together_say_no_more_than_one_that_is_off_by_as_much():
    assert (pixel_information_factor(np.array([0.5, 2.0]), 0.0) == 1).all()
    sigma, common = np.full(40, 0.5), 3.0
    information = (pixel_information_factor(sigma, common) / sigma**2).sum()
    np.testing.assert_allclose(1 / information, 0.5**2 / 40 + common**2)  # the variance of the mean of the 40
    seen, _ = observations_of(
        [replace(frame_features(0, 1, 2, 3), common_px=2.0), frame_features(1, 1, 2)], landmarks(4)
    )
    np.testing.assert_allclose(seen.share_px, [1 / 13] * 3 + [1.0] * 2)
