"""Results that survive failures and interruptions, one or several jobs at a time."""

import json
import threading
from typing import NamedTuple

import pytest
from uncle.recon.core.errors import DataError, RunError
from uncle.recon.core.events import Note, Warn
from uncle.recon.evaluation.bench.records import carry_out, duration


class Job(NamedTuple):
    number: int

    @property
    def key(self):
        return f"job {self.number}"


JOBS = [Job(number) for number in range(4)]


def always(job, record):
    return True


def test_what_is_done_is_kept_and_what_failed_is_tried_again(tmp_path):
    path, calls, seen, said = tmp_path / "runs.json", [], [], []

    def execute(job):
        calls.append(job.number)
        if len(calls) == 2:
            raise RunError("no surface")
        return {"number": job.number}

    def each(records, failed):
        seen.append((len(records), len(failed), len(json.loads(path.read_text()))))

    records, failed = carry_out(JOBS, path, execute, always, on_event=said.append, each=each, session="now")
    assert failed == {"job 1": "no surface"}
    assert set(records) == {"job 0", "job 2", "job 3"} == set(json.loads(path.read_text()))
    assert {record["session"] for record in records.values()} == {"now"}
    assert seen == [(1, 0, 1), (1, 1, 1), (2, 1, 2), (3, 1, 3)]  # written after every run
    assert [type(event) for event in said] == [Note, Warn, Note, Note]
    assert "no surface" in said[1].text
    records, failed = carry_out(JOBS, path, execute, lambda job, record: job.number != 3)
    assert (calls, failed, len(records)) == ([0, 1, 2, 3, 1, 3], {}, 4)  # a record that says too little is made again
    assert carry_out(JOBS, path, execute, always)[0] == json.loads(path.read_text())
    assert len(calls) == 6


def test_an_interruption_keeps_what_there_is(tmp_path):
    path = tmp_path / "runs.json"

    def execute(job):
        if job.number == 2:
            raise KeyboardInterrupt
        return {}

    with pytest.raises(KeyboardInterrupt):
        carry_out(JOBS, path, execute, always)
    assert set(json.loads(path.read_text())) == {"job 0", "job 1"}
    assert set(carry_out(JOBS[2:3], path, lambda job: {}, always)[0]) == {"job 0", "job 1", "job 2"}


def test_a_defect_of_the_program_is_no_failed_run(tmp_path):
    with pytest.raises(ZeroDivisionError):
        carry_out(JOBS, tmp_path / "runs.json", lambda job: {"x": 1 // 0}, always)


def test_jobs_run_side_by_side_and_no_more_than_asked(tmp_path):
    both, lock, at_work, most = threading.Barrier(2, timeout=20), threading.Lock(), set(), []

    def execute(job):
        with lock:
            at_work.add(job)
            most.append(len(at_work))
        both.wait()  # passes only if two are here at once
        with lock:
            at_work.discard(job)
        return {}

    records, failed = carry_out(JOBS, tmp_path / "runs.json", execute, always, parallel=2)
    assert (len(records), failed, max(most)) == (4, {}, 2)


def test_a_broken_file_of_results_is_not_overwritten(tmp_path):
    path = tmp_path / "runs.json"
    path.write_text("{")
    with pytest.raises(DataError, match="move it away"):
        carry_out(JOBS, path, lambda job: {}, always)
    assert path.read_text() == "{"


@pytest.mark.parametrize(("seconds", "text"), [(5, "5 s"), (600, "10 min"), (9000, "2.5 h")])
def test_durations(seconds, text):
    assert duration(seconds) == text
