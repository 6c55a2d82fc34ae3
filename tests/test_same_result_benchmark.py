"""`benchmarks/same_result.py`: cases are read, results are repeatable, and differences are named."""

import importlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from uncle.datasets.synth.write import SynthOptions, make_dataset
from uncle.recon.core.errors import ConfigError, RunError
from uncle.recon.core.mesh import Mesh
from uncle.recon.run.directory import RunDirectory

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # the programs import each other by their bare names
same_result = importlib.import_module("same_result")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a=room:0:40:--sensors sl sgm", ("a", "room", "0:40", ("--sensors", "sl", "sgm"))),
        ("b=some/room::", ("b", "some/room", "", ())),
        ("c=room:0:9:2:--set x='[1, 2]'", ("c", "room", "0:9:2", ("--set", "x=[1, 2]"))),
        ("d=room:::10:--track", ("d", "room", "::10", ("--track",))),
        ("e=room:0:40:", ("e", "room", "0:40", ())),
    ],
)
def test_cases_are_read(text, expected):
    case = same_result.parse_case(text, Path("data"))
    assert (case.name, str(case.dataset), case.frames, case.options) == (
        expected[0], f"data/{expected[1]}", *expected[2:],
    )  # fmt: skip


@pytest.mark.parametrize("text", ["room:0:40:", "a=room", "a=room:--track", "=room::"])
def test_other_cases_are_an_error(text):
    with pytest.raises(ConfigError, match="NAME=DATASET"):
        same_result.parse_case(text)


def test_built_in_cases_are_readable_and_have_names_of_their_own():
    for texts in (same_result.FULL_CASES, same_result.QUICK_CASES):
        names = [same_result.parse_case(text).name for text in texts]
        assert len(set(names)) == len(names) > 5


def test_differences_name_the_case_and_the_part():
    first = {"a": {"mesh": "1", "trajectory": "2"}, "b": {"mesh": "1"}}
    assert same_result.differences(first, first) == []
    second = {"a": {"mesh": "9", "trajectory": "2", "beta": "3"}}
    assert same_result.differences(first, second) == ["a: beta, mesh differ", "b: not in the reference"]


@pytest.mark.parametrize("content", [None, "{", "[]", '{"cases": 1}'])
def test_a_broken_reference_is_one_error(tmp_path, content):
    path = tmp_path / "reference.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(RunError, match=r"reference\.json"):
        same_result.load_results(path)


def test_property_names_do_not_count_but_every_value_does(tmp_path):
    run = RunDirectory(tmp_path)
    run.trajectory_path.write_text("0 0 0 0 0 0 0 1\n")
    triangle = Mesh(np.eye(3, dtype=np.float32), np.array([[0, 1, 2]], np.int32), sigma=np.ones(3, np.float32))
    triangle.save(run.mesh_path)
    before = same_result.digests_of(tmp_path)
    assert set(before) == {"mesh", "trajectory"}
    content = run.mesh_path.read_bytes()
    run.mesh_path.write_bytes(content.replace(b"property float sigma", b"property float other"))
    assert same_result.digests_of(tmp_path) == before
    replace(triangle, sigma=np.full(3, 2, np.float32)).save(run.mesh_path)
    assert same_result.digests_of(tmp_path)["mesh"] != before["mesh"]


def test_a_tiny_case_gives_the_same_digests_twice_and_other_settings_other_ones(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    make_dataset(tmp_path / "room", SynthOptions(frames=4, size_px=64, seed=0, sensors=("sl",)))
    case = "tiny=room:0:3:--sensors sl --voxel 0.1 --method tsdf"
    assert same_result.main([case, "--out", "first.json"]) == 0
    assert set(json.loads(Path("first.json").read_text())["cases"]["tiny"]) == {"mesh", "trajectory"}
    assert same_result.main([case, "--out", "second.json", "--against", "first.json"]) == 0
    assert "all 1 cases are equal" in capsys.readouterr().out
    other = case.replace("0.1", "0.12")
    assert same_result.main([other, "--out", "second.json", "--against", "first.json"]) == 1
    assert "tiny: mesh differ" in capsys.readouterr().out
    assert same_result.main(["tiny=nowhere::", "--out", "third.json"]) == 1
    assert "tiny: failed" in capsys.readouterr().out
