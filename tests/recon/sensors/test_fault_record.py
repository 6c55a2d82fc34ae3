"""What is said about the faults of a sensor."""

import json

from uncle.recon.run.directory import RunDirectory
from uncle.recon.sensors.fault_record import Stretch, describe, save, stretches
from uncle.recon.stages.report import fault_section


def spelled(letters: str, first: int = 0, step: int = 1):
    words = {"o": "ok", "m": "missing", "f": "frozen", "d": "inconsistent"}
    return {first + step * i: words[letter] for i, letter in enumerate(letters)}


def test_stretches_are_counted_in_mapped_frames():
    found = stretches(spelled("oofffdo", first=10, step=2))
    assert found == [Stretch("frozen", 14, 18, 3), Stretch("inconsistent", 20, 20, 1)]


def test_sentences_name_what_lasted():
    assert describe("sl", spelled("o" * 20)) == []
    assert describe("sl", spelled("ooffooo")) == []
    assert describe("sl", spelled("oofffooodddd")) == [
        "sl: frozen from frame 2 to 4, left out",
        "sl: at odds with the map from frame 8 to 11, left out",
    ]
    assert describe("tof", spelled("mmmo" * 2)) == ["tof: no readings from frame 0 to 2 and from frame 4 to 6"]


def test_a_slow_sensor_is_one_sentence():
    assert describe("tof", spelled("om" * 20)) == ["tof: no readings in 20 of 40 frames"]
    assert describe("tof", spelled("o" * 20 + "of" * 2)) == []
    assert describe("tof", spelled("ommmm" * 10)) == ["tof: no readings in 40 of 50 frames"]


def test_the_file_holds_every_frame_that_was_left_out(tmp_path):
    save(tmp_path / "sensors.json", {"a": spelled("ooofo"), "b": spelled("ommmm")})
    sensors = json.loads((tmp_path / "sensors.json").read_text())["sensors"]
    fault = {"reason": "frozen", "first": 3, "last": 3, "frames": 1}
    assert sensors["a"] == {"frames": 5, "used_frames": 4, "faults": [fault], "sentences": []}
    assert (sensors["b"]["used_frames"], sensors["b"]["sentences"]) == (1, ["b: no readings from frame 1 to 4"])


def test_the_report_repeats_what_was_said(tmp_path):
    run = RunDirectory(tmp_path)
    assert fault_section(run, "b") == ""
    save(run.sensors_path, {"a": spelled("ooooo"), "b": spelled("offff")})
    assert "b: frozen from frame 1 to 4, left out" in fault_section(run, "b")
    assert fault_section(run, "a") == fault_section(run, "c") == ""
    run.sensors_path.write_text('{"sensors": [1]}')
    assert fault_section(run, "b") == ""
