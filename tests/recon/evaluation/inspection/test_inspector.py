"""Errors put into a recording of known truth are named, with the right number."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from uncle.recon.core.correction import CorrectedRecording, Correction
from uncle.recon.core.errors import DataError, FrameError
from uncle.recon.evaluation.inspection import Verdict, inspect_recording, inspector
from uncle.recon.evaluation.inspection.correspondences import FrameInterval
from uncle.recon.evaluation.inspection.inspector import QUICK, THOROUGH
from uncle.recon.evaluation.inspection.registration import Registration


def inspect(recording, effort=QUICK, **options):
    return inspect_recording(
        recording, has_timestamps=recording.has_timestamps, max_depth_m=10.0, effort=effort, **options
    )


def finding(inspection, check):
    return next(one for one in inspection.findings if one.check == check)


def test_a_good_recording_fits(box_recording):
    inspection = inspect(box_recording, THOROUGH)
    assert inspection.first is None
    assert inspection.correction is None
    assert finding(inspection, "depth scale").verdict is Verdict.OK


@pytest.mark.parametrize(
    ("error", "check", "field", "expected", "tolerance"),
    [
        (Correction(depth_factor=5.0), "depth scale", "depth_factor", 0.2, 1e-9),
        (Correction(depth_factor=0.001), "depth scale", "depth_factor", 1000.0, 1e-6),
        (Correction(depth_factor=1 / 6.5535), "depth scale", "depth_factor", 6.5535, 0.1),
        (Correction(translation_factor=1000.0), "pose scale", "translation_factor", 0.001, 1e-9),
        (Correction(focal_x=1.3, focal_y=1.3), "intrinsics", "focal_x", 1 / 1.3, 0.01),
        (Correction(focal_x=1.3), "intrinsics", "focal_x", 1 / 1.3, 0.01),
        (Correction(focal_x=2.0, focal_y=2.0, shift_x=80.0, shift_y=60.0), "intrinsics", "shift_x", -80.0, 2.0),
        (Correction(is_inverted=True), "pose convention", "is_inverted", True, 0),
        (Correction(is_opengl=True), "pose convention", "is_opengl", True, 0),
        (Correction(lag=2.0), "pose clock", "lag", -2.0, 1e-9),
        (Correction(lag=-1.5), "pose clock", "lag", 1.5, 0.2),
    ],
    ids=str,
)
def test_an_error_is_named_with_its_size(box_recording, error, check, field, expected, tolerance):
    inspection = inspect(CorrectedRecording(box_recording, error))
    first = inspection.first
    assert (first.check, first.verdict) == (check, Verdict.WRONG), first
    assert getattr(first.correction, field) == pytest.approx(expected, abs=tolerance)
    assert first.correction == inspection.correction


def test_another_scale_of_colour_is_believed_unless_matches_contradict(box_recording, monkeypatch):
    """Few views of one scene can agree best at a scale by chance; the focal length then shows that it is one."""
    best = Registration(x=0.0, y=0.0, scale=1.15, height=20.0, gain=9.0, outline=9000)
    monkeypatch.setattr(
        inspector,
        "measure_registration",
        lambda *tried: {"depth": best if len(tried[3]) > 1 else replace(best, scale=1.0, height=1.0)},
    )
    assert inspect(box_recording).first is None
    zoomed = CorrectedRecording(box_recording, Correction(focal_x=1 / 1.15, focal_y=1 / 1.15))
    inspection = inspect(zoomed)
    assert (inspection.first.check, inspection.first.verdict) == ("registration", Verdict.WRONG)
    assert inspection.correction is None


def test_depth_along_the_ray_is_named(box_recording):
    class AlongRay(CorrectedRecording):
        def depth(self, index, sensor):
            return self.recording.depth(index, sensor) * self.camera.rays().norm(dim=-1)

    inspection = inspect(AlongRay(box_recording, Correction()))
    assert inspection.first.check == "depth along the ray"
    assert inspection.correction == Correction(is_along_ray=True)


def test_a_correction_undoes_the_error(box_recording):
    wrong = CorrectedRecording(box_recording, Correction(depth_factor=5.0))
    right = CorrectedRecording(wrong, inspect(wrong).correction)
    torch.testing.assert_close(right.depth(7, "depth"), box_recording.depth(7, "depth"))


def test_poses_of_other_frames_are_wrong_and_cannot_be_mended(box_recording):
    class Shuffled(CorrectedRecording):
        def pose(self, index):
            return self.recording.pose((index * 17) % len(self))

    inspection = inspect(Shuffled(box_recording, Correction()))
    assert inspection.first.verdict is Verdict.WRONG
    assert inspection.first.check == "pose convention"
    assert inspection.correction is None


def test_without_poses_units_are_unknown_but_an_implausible_depth_is_doubted(box_recording):
    class Unposed(CorrectedRecording):
        def pose(self, index):
            return None

    assert finding(inspect(Unposed(box_recording, Correction())), "depth scale").verdict is Verdict.UNKNOWN
    doubted = inspect(Unposed(box_recording, Correction(depth_factor=1000.0))).first
    assert (doubted.check, doubted.verdict) == ("depth: range", Verdict.DOUBT)


def test_exchanged_names_of_sensors_are_named(box_recording):
    class TwoSensors(CorrectedRecording):
        def depth(self, index, sensor):
            depth = self.recording.depth(index, "depth")
            share = {"sl": self.noise[0], "sgm": self.noise[1]}[sensor]
            generator = np.random.default_rng(index)
            blocks = generator.normal(0.0, share, (depth.shape[0] // 8 + 1, depth.shape[1] // 8 + 1))
            noise = np.kron(blocks, np.ones((8, 8)))[: depth.shape[0], : depth.shape[1]]
            return depth * torch.from_numpy(1 + noise).float()

    two = TwoSensors(box_recording, Correction())
    two.sensors, two.noise = ("sl", "sgm"), (0.002, 0.02)
    assert inspect(two).first is None
    two.noise = (0.02, 0.002)
    assert inspect(two).first.check == "sensor names"


def test_repeated_images_of_a_moving_camera_are_found(box_recording):
    class Frozen(CorrectedRecording):
        def color(self, index):
            return self.recording.color(0)

    assert finding(inspect(Frozen(box_recording, Correction())), "repeated images").verdict is Verdict.WRONG


def test_a_sensor_without_measurements_is_wrong(box_recording):
    class Empty(CorrectedRecording):
        def depth(self, index, sensor):
            return torch.zeros(self.camera.height, self.camera.width)

    first = inspect(Empty(box_recording, Correction())).first
    assert (first.check, first.verdict) == ("depth: depth", Verdict.WRONG)


def test_images_that_cannot_be_read_are_left_out(box_recording):
    class Unreadable(CorrectedRecording):
        def color(self, index):
            if index % 5 == 0:
                raise FrameError("truncated")
            return self.recording.color(index)

        def depth(self, index, sensor):
            if index % 7 == 0:
                raise DataError("truncated")
            return self.recording.depth(index, sensor)

    assert inspect(Unreadable(box_recording, Correction())).first is None


def test_an_interval_of_frames_is_numbered_from_zero(box_recording):
    interval = FrameInterval(box_recording, 5, 25)
    assert len(interval) == 20
    np.testing.assert_array_equal(interval.pose(0), box_recording.pose(5))
    assert inspect_recording(interval, has_timestamps=False, max_depth_m=10.0).first is None


def test_a_clock_with_a_gap_is_doubted(box_recording):
    class Clocked(CorrectedRecording):
        def timestamp(self, index):
            return index / 30 + (5.0 if index > 12 else 0.0)

    clocked = Clocked(box_recording, Correction())
    clocked.has_timestamps = True
    found = finding(inspect(clocked), "time stamps")
    assert found.verdict is Verdict.DOUBT
    assert found.value == pytest.approx(5.033, abs=0.01)
