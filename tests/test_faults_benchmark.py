"""What the benchmark of failing sensors lets fail, and its table."""

import importlib
import sys
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # the programs import each other by their bare names
faults = importlib.import_module("faults")


class Recording:
    """Ten frames of two sensors that read the index of the frame, but for one hole."""

    sensors = ("a", "b")

    def __len__(self):
        return 10

    def depth(self, index, sensor):
        return torch.tensor([index + 1.0, 0.0])


@pytest.mark.parametrize(("fault", "expected"), [("zero", 0.0), ("frozen", 4.0), ("shifted", 8.2)])
def test_one_sensor_fails_from_a_frame_on(fault, expected):
    spoilt = faults.FaultyRecording(Recording(), "a", fault, 4)
    assert (spoilt.sensors, len(spoilt)) == (("a", "b"), 10)
    torch.testing.assert_close(spoilt.depth(7, "a"), torch.tensor([expected, 0.0]))
    torch.testing.assert_close(spoilt.depth(3, "a"), torch.tensor([4.0, 0.0]))
    torch.testing.assert_close(spoilt.depth(7, "b"), torch.tensor([8.0, 0.0]))


def test_every_sensor_fails_in_every_way_after_the_recording_as_it_is():
    jobs = faults.plan("room", "a+b", ["uncle"], ["none", "zero", "frozen"], ["a", "b"], 65, 0)
    assert [(job.fault, job.sensor) for job in jobs] == [
        ("none", ""), ("zero", "a"), ("zero", "b"), ("frozen", "a"), ("frozen", "b"),
    ]  # fmt: skip
    assert len({job.key for job in jobs}) == 5


def test_cost_is_against_the_same_method_without_a_fault():
    def record(method, fault, f_score):
        job = faults.Job("room", "a+b", method, fault, "a" if fault != "none" else "", 65, 0)
        messages = ["a: frozen"] if fault != "none" else []
        return job._asdict() | {"f_score_5cm": f_score, "f_score_2cm": 0.5, "messages": messages}

    cases = [("uncle", "none", 0.9), ("tsdf", "none", 0.8), ("uncle", "frozen", 0.89), ("tsdf", "frozen", 0.5)]
    lines = faults.markdown(record(*case) for case in cases).splitlines()[2:]
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    assert [row[-2] for row in rows] == ["-", "-", "1.00", "30.00"]
    assert rows[2] == ["a+b", "uncle", "frozen", "a", "89.00", "50.00", "1.00", "a: frozen"]
