"""The expected motion: constant velocity, none of a lost camera, and only as far as frames showed it."""

import numpy as np
from uncle.recon.core.se3 import apply_motion, motion_between
from uncle.recon.tracking.localisation import Localisation
from uncle.recon.tracking.motion_model import MotionModel

STEP = np.array([0.05, -0.02, 0.01, 0.03, 0.0, -0.02])


def at(pose: np.ndarray, shown: np.ndarray | None = None) -> Localisation:
    return Localisation(pose, np.eye(6)) if shown is None else Localisation(pose, np.eye(6), shown=shown)


def moving(frames: int = 3) -> tuple[MotionModel, np.ndarray]:
    """A model of a camera that moved by STEP from each frame to the next, and its last pose."""
    model, last = MotionModel(), np.eye(4)
    model.update(None, at(last))
    for _ in range(frames - 1):
        pose = apply_motion(last, STEP)
        model.update(last, at(pose))
        last = pose
    return model, last


def test_a_camera_repeats_its_motion():
    model, last = moving()
    np.testing.assert_allclose(motion_between(last, model.predict(last)), STEP, atol=1e-9)


def test_one_frame_shows_no_motion():
    model, last = moving(1)
    np.testing.assert_array_equal(model.predict(last), last)
    assert not model.lost


def test_motion_that_the_frame_does_not_show_is_not_repeated():
    model, last = moving(1)
    model.update(last, at(apply_motion(last, STEP), shown=np.diag([1.0, 0, 0, 0, 0, 0])))
    np.testing.assert_allclose(motion_between(last, model.predict(last)), [STEP[0], 0, 0, 0, 0, 0], atol=1e-9)


def test_a_lost_camera_is_expected_where_it_was_and_its_next_motion_is_unknown():
    model, last = moving()
    model.update(last, None)
    model.update(last, None)
    assert (model.lost, model.lost_frames) == (True, 2)
    np.testing.assert_array_equal(model.predict(last), last)
    model.update(last, at(apply_motion(last, 5 * STEP)))
    assert not model.lost
    np.testing.assert_array_equal(model.predict(last), last)


def test_a_restored_model_continues():
    model, last = moving()
    restored = MotionModel()
    restored.load_state_dict(model.state_dict())
    np.testing.assert_array_equal(restored.predict(last), model.predict(last))
    model.update(last, None)
    restored.load_state_dict(model.state_dict())
    assert restored.lost_frames == 1
