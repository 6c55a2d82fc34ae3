"""The benchmarks of interruptions, of memory and of `--fix`: their plans, what they call a mixture, and their sums."""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.manifest import Manifest

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # the programs import each other by their bare names
fix, interruptions, memory = map(importlib.import_module, ("fix", "interruptions", "memory"))
CAMERA = {"width": 4, "height": 3, "fx": 4.0, "fy": 4.0, "cx": 1.5, "cy": 1.0}
RESULTS = {"preprocess": "frames/color/0.png", "map": "map/field.pt", "mesh": "mesh.ply"}


# --- interruptions ---------------------------------------------------------------------------------------------------
def test_more_moments_begin_with_the_fewer_and_have_every_pair_of_commands():
    jobs = interruptions.plan(20, 0)
    assert jobs[:5] == interruptions.plan(5, 0)
    assert {(job.first, job.second) for job in jobs} == set(interruptions.PAIRS)
    assert {job.killed for job in jobs} == {"", "first", "second"}
    assert len({job.key for job in jobs}) == 20
    assert interruptions.plan(5, 1) != jobs[:5]


class Undisturbed:
    """Digests of runs that exist in the test alone."""

    def digests(self, frames, seed):
        contents = {"preprocess": f"frames {frames}", "map": f"map {frames} {seed}", "mesh": f"mesh {frames} {seed}"}
        return {RESULTS[stage]: interruptions.digest_of(text.encode()) for stage, text in contents.items()}


@pytest.fixture
def finished(tmp_path):
    """A run of frames 1 and seed 2, whose files say what made them."""
    run = RunDirectory(tmp_path)
    run.save_manifest(
        Manifest(
            dataset="room", dataset_format="memory", name="room", camera=CAMERA, sensors=("sl",), has_timestamps=False
        )
    )
    facts = {"preprocess": {"frame_range": [1, 9, 3]}, "map": {"seed": 2}, "mesh": {}}
    inputs = {"preprocess": (), "map": ("preprocess",), "mesh": ("map",)}
    for stage, text in (("preprocess", "frames 1"), ("map", "map 1 2"), ("mesh", "mesh 1 2")):
        path = tmp_path / RESULTS[stage]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        run.finish_stage(stage, stage, 0.0, facts[stage], inputs[stage])
    return run


def test_a_run_is_what_its_manifest_says(finished):
    state = interruptions.state(finished.root, Undisturbed())
    assert (state.frames, state.seed, state.has_mesh, state.wrong) == (1, 2, True, ())
    assert str(state) == "frames 1, map 2, mesh"


@pytest.mark.parametrize(("stage", "text"), [("preprocess", "frames 0"), ("map", "map 0 2"), ("mesh", "mesh 1 0")])
def test_a_file_of_another_command_is_a_mixture(finished, stage, text):
    (finished.root / RESULTS[stage]).write_text(text)
    assert interruptions.state(finished.root, Undisturbed()).wrong == (RESULTS[stage],)


def test_a_file_too_many_and_a_file_that_is_missing_are_named(finished):
    (finished.root / "beta").mkdir()
    (finished.root / "beta" / "0.png").write_text("of an earlier map")
    (finished.root / RESULTS["map"]).unlink()
    assert interruptions.state(finished.root, Undisturbed()).wrong == ("beta/0.png", RESULTS["map"])


def test_what_the_manifest_calls_outdated_may_be_anything(finished):
    finished.begin_stage("map")
    (finished.root / RESULTS["map"]).write_text("half")
    state = interruptions.state(finished.root, Undisturbed())
    assert (state.frames, state.seed, state.has_mesh, state.wrong) == (1, None, False, ())


@pytest.mark.parametrize(
    ("code", "line", "is_right", "text"),
    [
        (0, "", True, "done"),
        (-9, "", True, "killed"),
        (1, "Error: run is in use by `uncle map` (process 7); run this again", True, "is in use by"),
        (1, "Error: run has no finished `map` stage", True, "has no finished"),
        (1, "KeyError: 'map' is in use by", False, "is in use by"),
        (1, "Error: the disk is full", False, "Error: the disk is full"),
    ],
)
def test_commands_end_well_or_say_why_they_do_not(code, line, is_right, text):
    ended = interruptions.Ended(code, 1.0, line)
    assert (ended.is_right, str(ended)) == (is_right, text)


def test_the_last_command_that_ended_well_made_the_result_or_a_killed_one():
    well, later, killed = (interruptions.Ended(code, at, "") for code, at in ((0, 1.0), (0, 2.0), (-9, 3.0)))
    assert interruptions.made_by("map", [("map", 1, later), ("map", 2, well)], 0) == {1}
    assert interruptions.made_by("map", [("map", 1, well), ("map", 2, killed)], 0) == {1, 2}
    assert interruptions.made_by("map", [("mesh", 1, well), ("map", 2, killed)], 0) == {0, 2}


# --- memory ----------------------------------------------------------------------------------------------------------
def record(case, blocks, peak_mb, named=()):
    return {"case": case, "frames": 4, "blocks": blocks, "peak_memory_mb": peak_mb, "named": list(named)}


def test_needs_are_a_fixed_part_and_one_for_each_block():
    records = [record(memory.ROOM, 1000, 300.0), record(memory.QUARTER, 3000, 400.0)]
    assert memory.needs(records) == (250.0, 0.05)
    rows = memory.markdown([*records, record("far", 1200, 341.0, ["frame 2 is far"])]).splitlines()
    assert rows[-1] == "| far | 4 | 1200 | 341 | 310 | 1.10 | frame 2 is far |"
    assert rows[2] == "| room | 4 | 1000 | 300 | 300 | 1.00 | - |"


class Recording:
    """Three poses; the last one is not known."""

    camera = "the camera"

    def pose(self, index):
        return None if index == 2 else np.eye(4)


def test_one_frame_is_moved_and_nothing_else():
    moved = memory.FarFrame(Recording(), 1, 1000.0)
    assert np.linalg.norm(moved.pose(1)[:3, 3]) == pytest.approx(1000)
    np.testing.assert_array_equal(moved.pose(0), np.eye(4))
    assert moved.pose(2) is None
    assert moved.camera == "the camera"


def test_the_room_comes_first_and_the_corridor_grows(tmp_path):
    jobs = memory.plan(tmp_path / "room", tmp_path / "corridor", [1000.0, 100_000.0], "")
    assert [(job.case, job.share, job.moved_m) for job in jobs] == [
        ("room", 1.0, 0.0), ("room, a frame 1 km off", 1.0, 1000.0), ("room, a frame 100 km off", 1.0, 100_000.0),
        ("corridor, first quarter", 0.25, 0.0), ("corridor, half", 0.5, 0.0), ("corridor", 1.0, 0.0),
    ]  # fmt: skip


# --- corrections -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("f_score", "l1_m", "reference_f_score", "is_good"),
    [(89.1, 9.0, 90.0, True), (88.9, 0.01, 90.0, False), (None, 0.0104, None, True), (None, 0.0106, None, False)],
)
def test_a_map_may_lose_a_point_or_five_per_cent(f_score, l1_m, reference_f_score, is_good):
    undisturbed = fix.Result("", reference_f_score, 0.01)
    assert fix.Result("depth_factor 0.2", f_score, l1_m).is_as_good_as(undisturbed) is is_good
