"""One owner per run directory: real processes that meet on one run."""

import os
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest
from uncle.recon.core.errors import RunError
from uncle.recon.core.events import Note
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.lock import reading, writing, writing_to
from uncle.recon.run.manifest import Manifest

OWNER = """
import sys
from pathlib import Path
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.lock import writing
with writing(RunDirectory(Path(sys.argv[1])), "map"):
    print("owned", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def run(tmp_path):
    directory = RunDirectory(tmp_path / "run")
    manifest = Manifest(
        dataset="room", dataset_format="folder", name="room", sensors=("depth",), has_timestamps=True,
        camera={"width": 64, "height": 48, "fx": 50.0, "fy": 51.0, "cx": 31.5, "cy": 23.5},
    )  # fmt: skip
    directory.save_manifest(manifest)
    return directory


@contextmanager
def owner(run):
    """Another process that owns the run until it gets a line."""
    child = subprocess.Popen(
        [sys.executable, "-c", OWNER, str(run.root)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout.readline() == "owned\n"
        yield child
    finally:
        child.kill()
        child.communicate()


def test_a_second_writer_is_told_who_the_owner_is(run):
    with owner(run) as child:
        with pytest.raises(RunError) as caught, writing(run, "mesh"):
            pass
        message = str(caught.value)
        assert f"{run.root} is in use by `uncle map` (process {child.pid}, since 20" in message
        assert "--wait" in message
        assert "\n" not in message
        child.communicate("end\n")
        assert child.returncode == 0
    with writing(run, "mesh") as is_writable:
        assert is_writable
    assert not run.lock_path.exists()


def test_the_lock_of_a_dead_owner_is_taken_over(run):
    with owner(run) as child:
        os.kill(child.pid, signal.SIGKILL)
        child.wait()
        assert run.lock_path.exists()
        events = []
        with writing(run, "mesh", events.append):
            pass
    assert [type(event) for event in events] == [Note]
    assert f"(process {child.pid}, " in events[0].text
    assert not run.lock_path.exists()


def test_a_waiting_writer_goes_on_when_the_owner_ends(run):
    patient, events = RunDirectory(run.root, waits=True), []
    with owner(run) as child:

        def end_owner(event):
            events.append(event)
            child.stdin.write("end\n")
            child.stdin.flush()

        with writing(patient, "mesh", end_owner):
            assert child.wait() == 0
    assert events[0].text.startswith("waiting for `uncle map`")


def test_two_writers_of_one_process_exclude_each_other(run):
    with writing(run, "map"), pytest.raises(RunError, match="in use"), writing(RunDirectory(run.root), "mesh"):
        pass


def test_reading_takes_no_lock_and_notices_a_change(run):
    with writing(run, "map"), reading(run):
        run.load_manifest()
    with pytest.raises(RunError, match="changed by another command"), reading(run):
        run.finish_stage("map", "0", 0.0, {})


def test_only_results_inside_the_run_need_it(run, tmp_path):
    with writing(run, "map"):
        with writing_to(run, tmp_path / "elsewhere.ply", "mesh"):
            pass
        with pytest.raises(RunError, match="in use"), writing_to(run, run.root / "other.ply", "mesh"):
            pass


def test_a_new_run_that_stays_empty_leaves_no_folder(tmp_path):
    run = RunDirectory(tmp_path / "new" / "run")
    with pytest.raises(RunError, match="uncle preprocess"), writing(run, "map"):
        pass
    assert not run.root.exists()
    with writing(run, "preprocess", is_new=True):
        assert run.lock_path.exists()
    assert not run.root.exists()


def test_a_run_that_cannot_be_written_can_be_read(run, monkeypatch):
    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", refuse)
        with writing(run, "eval", may_be_read_only=True) as is_writable:
            assert not is_writable
        with pytest.raises(RunError, match="no permission to write there"), writing(run, "map"):
            pass
