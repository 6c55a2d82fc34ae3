"""The program as a process of its own."""

import json
import os
import sys
import threading

import pytest
from uncle.recon.core.errors import RunError
from uncle.recon.evaluation.bench import process


def python(code):
    return [sys.executable, "-c", code]


def test_the_launcher_is_the_program_of_this_interpreter():
    seconds, out = process.run_process("uncle", [*process.LAUNCHER, "--version"])
    assert out.startswith("uncle, version")
    assert seconds > 0


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("import sys; print('noise', file=sys.stderr); sys.exit('Error: no poses')", "map: no poses"),
        ("print('only this'); raise SystemExit(3)", "map: only this"),
        ("raise SystemExit(3)", "map: ended with code 3 and no message"),
    ],
)
def test_a_failure_is_its_last_line(tmp_path, code, message):
    with pytest.raises(RunError) as caught:
        process.run_process("map", python(code), log=tmp_path / "log.txt")
    assert str(caught.value) == message
    assert (tmp_path / "log.txt").read_text().startswith("--- map\n")


def test_threads_are_told_to_the_process():
    _, out = process.run_process("x", python("import os; print(os.environ['OMP_NUM_THREADS'])"), threads=3)
    assert out.strip() == "3"


def test_all_processes_can_be_stopped(tmp_path):
    failed, sign = [], tmp_path / "started"

    def wait():
        try:
            process.run_process("sleep", python(f"import time; open({str(sign)!r}, 'w').close(); time.sleep(60)"))
        except RunError as error:
            failed.append(str(error))

    thread = threading.Thread(target=wait)
    thread.start()
    while not sign.exists():
        assert thread.is_alive()
    try:
        process.stop_all()
        thread.join(20)
        assert len(failed) == 1
        with pytest.raises(RunError, match="stopped"):
            process.run_process("next", python(""))
    finally:
        process.stop_all(False)
    process.run_process("next", python(""))


def test_neighbours_have_cores_of_their_own(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {4, 5, 6, 7, 9}, raising=False)
    assert [process.share_of_cores(part, 2) for part in range(2)] == [[4, 5], [6, 7]]
    assert process.share_of_cores(0, 1) == [4, 5, 6, 7, 9]
    assert [process.share_of_cores(part, 7) for part in range(7)] == [[4], [5], [6], [7], [9], [4], [5]]


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="threads cannot be pinned here")
def test_a_pinned_thread_and_its_processes_stay_there_and_others_do_not():
    before = process.share_of_cores(0, 1)
    ask = python("import os; print(sorted(os.sched_getaffinity(0)))")
    found = {}

    def work():
        process.stay_on(before[:1])
        found["share"] = process.share_of_cores(0, 1)
        found["child"] = process.run_process("x", ask)[1].strip()

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert found == {"share": before, "child": str(before[:1])}
    assert process.run_process("x", ask)[1].strip() == str(before)


def test_a_new_run_borrows_the_frames_and_forgets_the_rest(tmp_path):
    base, run = tmp_path / "base", tmp_path / "run"
    (base / "frames").mkdir(parents=True)
    (base / "manifest.json").write_text("{}")
    (run / "beta").mkdir(parents=True)
    process.new_run(base, run)
    assert sorted(path.name for path in run.iterdir()) == ["frames", "manifest.json"]
    assert (run / "frames").resolve() == (base / "frames").resolve()
    process.new_run(base, run)
    assert (base / "frames").is_dir()  # removing the borrower leaves what it borrowed


@pytest.mark.parametrize("gpu", [{}, {"gpu_memory_mb": 900.0}])
def test_costs_are_those_of_the_manifest_and_the_process(tmp_path, gpu):
    facts = {"seconds": {"fusion": 2.0}, "peak_memory_mb": 512.0, "sensors": ["sl"]} | gpu
    (tmp_path / "manifest.json").write_text(json.dumps({"stages": {"map": {"facts": facts}}}))
    expected = {"wall_s": 9.0, "stage_seconds": {"fusion": 2.0}, "peak_memory_mb": 512.0} | gpu
    assert process.map_costs(tmp_path, 9.0) == expected
