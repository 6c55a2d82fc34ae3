"""A small fixed part of `make fuzz`, and that the fuzzer sees every kind of defect."""

import importlib
import json
import random
import sys
import warnings
from pathlib import Path

import click
import numpy as np
import pytest
from uncle.recon.core.errors import DataError

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))  # the programs import each other by their bare names
corpus, mutations, runner, samples, targets, trial, worker = (
    importlib.import_module(f"fuzzing.{name}")
    for name in ("corpus", "mutations", "runner", "samples", "targets", "trial", "worker")
)
Sample = samples.Sample
TUM = Sample("tum.txt", {"tum.txt": b"1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n"}, "tum.txt")


def drawn(sample, seed):
    """A few mutations of a sample."""
    rng = random.Random(seed)
    kinds = mutations.fitting_kinds(sample)
    return [
        mutations.Mutation(rng.choice(kinds), *(rng.randrange(mutations.RANGE) for _ in range(3)))
        for _ in range(rng.randint(1, 4))
    ]


@pytest.mark.parametrize("target", targets.FILES, ids=lambda target: target.name)
def test_valid_inputs_are_read_and_damaged_ones_end_in_one_line(tmp_path, target):
    valid = target.samples(tmp_path)
    for sample in valid[:3]:
        assert trial.attempt(target, sample, tmp_path / "work").kind in (trial.RIGHT, trial.REFUSED), sample.name
    for seed in range(20):
        sample = valid[seed % len(valid)]
        changes = drawn(sample, seed)
        outcome = trial.attempt(target, mutations.mutate(sample, changes, valid), tmp_path / "work")
        assert not outcome.is_failure, f"{sample.name} {changes}: {outcome.text}"


@pytest.mark.parametrize("kind", mutations.KINDS)
def test_every_kind_of_damage_changes_some_input_the_same_way_each_time(kind):
    dataset = corpus.datasets()[0]
    arrays = Sample("arrays", {"a.npz": corpus.depth_images()[9].files["depth.npz"], "m.pt": tensors(), **TUM.files})
    found = 0
    for place in range(0, mutations.RANGE, 4096):
        for sample in (dataset, arrays):
            change = [mutations.Mutation(kind, (place * 7) % mutations.RANGE, place, place // 3 + 1)]
            changed, again = (mutations.mutate(sample, change, [dataset, TUM]) for _ in range(2))
            assert changed.files.keys() == again.files.keys()
            found += changed.files != sample.files
    assert found


def tensors():
    import io

    import torch

    buffer = io.BytesIO()
    torch.save({"a": torch.ones(3), "b": [1, 2]}, buffer)
    return buffer.getvalue()


def test_what_stands_in_the_place_of_files_is_refused(tmp_path):
    for kind in (samples.FOLDER, samples.LOOP, samples.PIPE, samples.ENDLESS):
        for target in targets.FILES[:9]:
            sample = target.samples(tmp_path)[0]
            damaged = Sample(sample.name, dict.fromkeys(sample.files, samples.Special(kind)), sample.main)
            outcome = trial.attempt(target, damaged, tmp_path / "work")
            assert not outcome.is_failure, f"{target.name} {kind}: {outcome.text}"


def raising(error):
    def call(path):
        raise error

    return call


def overflow(path):
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)


def hungry(path):
    try:
        np.zeros(1 << 50)
    except MemoryError as error:
        raise DataError("too large") from error


@pytest.mark.parametrize(
    ("call", "kind"),
    [
        (lambda path: None, trial.RIGHT),
        (raising(DataError("no poses")), trial.REFUSED),
        (raising(click.UsageError("no such option")), trial.REFUSED),
        (raising(KeyError("x")), trial.TRACEBACK),
        (raising(SystemExit(1)), trial.TRACEBACK),
        (raising(targets.WrongResultError("shape")), trial.WRONG),
        (raising(click.ClickException("two\nlines")), trial.WRONG),
        (raising(DataError("")), trial.WRONG),
        (raising(DataError("x" * 5000)), trial.WRONG),
        (overflow, trial.WRONG),
        (raising(MemoryError()), trial.MEMORY),
        (hungry, trial.MEMORY),
    ],
)
def test_what_becomes_of_an_input_is_told(tmp_path, call, kind):
    outcome = trial.call(targets.Target("any", lambda folder: [TUM], call), tmp_path)
    assert outcome.kind == kind


def test_a_defect_is_reported_once_with_its_smallest_input(tmp_path):
    def fails_on_letters(path):
        if path.exists() and path.is_file() and any(byte > 64 for byte in path.read_bytes()):
            raise KeyError("letter")

    told = []
    batch = worker.Batch(targets.Target("any", None, fails_on_letters), [TUM], tmp_path, told.append, set())
    batch.run(3, 100, set())
    defects = [message for message in told if "defect" in message]
    assert len(defects) == 1
    kept = Path(defects[0]["sample"]["folder"]) / "input" / "tum.txt"
    assert any(byte > 64 for byte in kept.read_bytes())
    last = [message for message in told if "begin" in message][-1]
    assert len(last["mutations"]) == 1


ECHO = "import json, sys\nprint(json.dumps({'ready': 1}), flush=True)\nfor line in sys.stdin:\n"
BEGIN = "    print(json.dumps({'begin': 'x', 'main': '', 'mutations': [], 'counts': True}), flush=True)\n"


@pytest.mark.parametrize(
    ("then", "kind"),
    [("    sys.exit(3)\n", trial.CRASH), ("    import time; time.sleep(60)\n", trial.HANG),
     ("    import os; os.abort()\n", trial.CRASH)],
)  # fmt: skip
def test_the_end_of_the_process_is_counted_and_another_one_goes_on(tmp_path, monkeypatch, then, kind):
    monkeypatch.setattr(runner, "HANG_S", 1.0)
    said = []
    fuzzer = runner.Fuzzer(["one", "two"], tmp_path, 0, said.append)
    (tmp_path / "worker" / "work" / "input").mkdir(parents=True)
    (tmp_path / "worker" / "work" / "input" / "a.txt").write_text("a")
    (tmp_path / "worker" / "stderr.txt").write_text("Segmentation fault")
    monkeypatch.setattr(fuzzer, "command", lambda: [sys.executable, "-c", ECHO + BEGIN + then])
    for name, tally in fuzzer.tallies.items():
        fuzzer.turn(name, tally)
    assert [tally.counts[kind] for tally in fuzzer.tallies.values()] == [1, 1]
    defect = json.loads((tmp_path / "defects" / "001-one" / "defect.json").read_text())
    assert (defect["kind"], defect["target"]) == (kind, "one")
    assert (tmp_path / "defects" / "001-one" / "input" / "a.txt").read_text() == "a"
    assert "| one | 1 |" in fuzzer.table(60.0)
    assert "--repeat" in said[-1]
