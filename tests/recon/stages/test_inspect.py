"""What `uncle preprocess` does with what an inspection finds, and the inspection of a run."""

import json

import pytest
import torch
from uncle.recon.core.correction import CorrectedRecording, Correction
from uncle.recon.core.errors import ConfigError, DataError
from uncle.recon.core.events import Note, Warn
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.frames import RunFrames
from uncle.recon.stages import preprocess as stage
from uncle.recon.stages.inspect import inspect_dataset, inspect_run
from uncle.recon.stages.preprocess import preprocess_run


@pytest.fixture
def run(tmp_path):
    return RunDirectory(tmp_path / "run")


@pytest.fixture
def preprocess(tmp_path, run):
    (tmp_path / "data").mkdir()

    def call(recording, **options):
        return preprocess_run(recording, run, dataset=tmp_path / "data", **options)

    return call


def test_a_wrong_scale_stops_preprocess_and_says_what_to_do(box_recording, preprocess, run):
    wrong = CorrectedRecording(box_recording, Correction(depth_factor=5.0))
    with pytest.raises(DataError, match=r"depth scale: .* 5 times too large.*--fix.*--force"):
        preprocess(wrong)
    assert not run.root.exists()


def test_fix_mends_it_and_records_it(box_recording, preprocess, run):
    events = []
    preprocess(CorrectedRecording(box_recording, Correction(depth_factor=5.0)), fix=True, on_event=events.append)
    assert any(isinstance(event, Note) and event.text.startswith("mended: depth scale") for event in events)
    true = box_recording.depth(3, "depth")
    torch.testing.assert_close(RunFrames(run).depth(3, "depth"), true, atol=6e-4, rtol=0)
    facts = run.load_manifest().stages["preprocess"].facts
    assert facts["correction"] == {"depth_factor": pytest.approx(0.2)}
    assert inspect_run(run).first is None


def test_force_goes_on_with_a_warning(box_recording, preprocess, run):
    events = []
    preprocess(CorrectedRecording(box_recording, Correction(depth_factor=5.0)), force=True, on_event=events.append)
    assert any(isinstance(event, Warn) and "depth scale" in event.text for event in events)
    assert inspect_run(run).first.check == "depth scale"


def test_what_cannot_be_mended_stops_in_spite_of_fix(box_recording, preprocess):
    class Shuffled(CorrectedRecording):
        def pose(self, index):
            return self.recording.pose((index * 17) % len(self))

    with pytest.raises(DataError, match="pose convention"):
        preprocess(Shuffled(box_recording, Correction()), fix=True)


def test_a_part_alone_does_not_stop_preprocess(box_recording, preprocess, run, monkeypatch):
    """Errors that a quick look at a few frames suggests, and the whole recording denies, are told as a doubt."""
    inspect = stage.inspect_recording

    def doubtful(frames, **options):
        is_part = len(frames) < len(box_recording)
        wrong = CorrectedRecording(box_recording, Correction(depth_factor=5.0))
        return inspect(wrong if is_part else frames, **options)

    monkeypatch.setattr(stage, "inspect_recording", doubtful)
    for options in ({}, {"fix": True}):
        events = []
        preprocess(box_recording, frames=slice(0, 10), overwrite=True, on_event=events.append, **options)
        told = [event.text for event in events if isinstance(event, Warn)]
        assert any("5 times too large" in text and "whole recording does not show it" in text for text in told)
    assert run.load_manifest().stages["preprocess"].facts["correction"] == {}


def test_frames_that_are_left_out_are_not_inspected(box_recording, preprocess):
    class WrongAtTheEnd(CorrectedRecording):
        def depth(self, index, sensor):
            return self.recording.depth(index, sensor) * (1.0 if index < 20 else 50.0)

    assert preprocess(WrongAtTheEnd(box_recording, Correction()), frames=slice(0, 20)).frames == 20


def test_the_page_has_findings_and_pictures(box_recording, tmp_path):
    inspect_dataset(box_recording, report=tmp_path / "page.html")
    page = (tmp_path / "page.html").read_text()
    assert page.count("<img ") == 3
    assert "depth scale" in page


def test_an_unknown_sensor_is_named(box_recording):
    with pytest.raises(ConfigError, match="no sensor 'sl'; there are: depth"):
        inspect_dataset(box_recording, ["sl"])


def test_findings_are_json(box_recording):
    findings = [one.to_dict() for one in inspect_dataset(box_recording).findings]
    assert {one["verdict"] for one in json.loads(json.dumps(findings))} <= {"ok", "unknown", "doubt", "wrong"}
