"""Faults of a sensor as intervals, sentences and a file."""

import json

from uncle.recon.run.directory import RunDirectory
from uncle.recon.sensors.fault_record import FaultInterval, fault_intervals, fault_sentences, save_faults
from uncle.recon.visualization.report_sections import fault_section


def spelled(letters: str, first: int = 0, step: int = 1):
    words = {"o": "ok", "m": "missing", "f": "frozen", "d": "inconsistent"}
    return {first + step * i: words[letter] for i, letter in enumerate(letters)}


def test_intervals_are_counted_in_mapped_frames():
    found = fault_intervals(spelled("oofffdo", first=10, step=2))
    assert found == [FaultInterval("frozen", 14, 18, 3), FaultInterval("inconsistent", 20, 20, 1)]


def test_sentences_name_what_lasted():
    assert fault_sentences("sl", spelled("o" * 20)) == []
    assert fault_sentences("sl", spelled("ooffooo")) == []
    assert fault_sentences("sl", spelled("oofffooodddd")) == [
        "sl: frozen from frame 2 to 4, left out",
        "sl: inconsistent with the map from frame 8 to 11, left out",
    ]
    assert fault_sentences("tof", spelled("mmmo" * 2)) == [
        "tof: no measurements from frame 0 to 2 and from frame 4 to 6"
    ]


def test_a_slow_sensor_is_one_sentence():
    assert fault_sentences("tof", spelled("om" * 20)) == ["tof: no measurements in 20 of 40 frames"]
    assert fault_sentences("tof", spelled("o" * 20 + "of" * 2)) == []
    assert fault_sentences("tof", spelled("ommmm" * 10)) == ["tof: no measurements in 40 of 50 frames"]


def test_the_file_holds_every_frame_that_was_left_out(tmp_path):
    save_faults(tmp_path / "sensors.json", {"a": spelled("ooofo"), "b": spelled("ommmm")})
    sensors = json.loads((tmp_path / "sensors.json").read_text())["sensors"]
    fault = {"reason": "frozen", "first": 3, "last": 3, "frames": 1}
    assert sensors["a"] == {"frames": 5, "used_frames": 4, "faults": [fault], "sentences": []}
    assert (sensors["b"]["used_frames"], sensors["b"]["sentences"]) == (1, ["b: no measurements from frame 1 to 4"])


def test_the_report_repeats_the_sentences(tmp_path):
    run = RunDirectory(tmp_path)
    assert fault_section(run, "b") == ""
    save_faults(run.sensors_path, {"a": spelled("ooooo"), "b": spelled("offff")})
    assert "b: frozen from frame 1 to 4, left out" in fault_section(run, "b")
    assert fault_section(run, "a") == fault_section(run, "c") == ""
    run.sensors_path.write_text('{"sensors": [1]}')
    assert fault_section(run, "b") == ""
