"""The process that tries inputs: it says which before it begins, so that its end, whatever it is, can be attributed."""

from __future__ import annotations

import hashlib
import json
import os
import resource
import sys
import time
from contextlib import suppress
from dataclasses import astuple
from pathlib import Path
from typing import Any, TextIO

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st
from hypothesis.errors import Flaky

from .mutations import RANGE, Mutation, fitting_kinds, mutate
from .samples import Sample
from .targets import TARGETS, Target
from .trial import Outcome, attempt

MAX_MUTATIONS = 5
MAX_SHRUNK_S = 1.0  # inputs that take longer are kept as they are: shrinking tries hundreds
MEMORY_BYTES = 4 << 30


def inputs(samples: list[Sample]) -> st.SearchStrategy[tuple[int, list[Mutation]]]:
    """A sample by its number, and mutations of it. They shrink towards few, and to the beginning of a file."""
    numbers = st.integers(0, RANGE - 1)

    def mutations(index: int) -> st.SearchStrategy[tuple[int, list[Mutation]]]:
        kinds = st.sampled_from(fitting_kinds(samples[index]))
        several = st.lists(st.builds(Mutation, kinds, numbers, numbers, numbers), min_size=1, max_size=MAX_MUTATIONS)
        return st.tuples(st.just(index), several)

    return st.integers(0, len(samples) - 1).flatmap(mutations)


class _Failure(Exception):
    """Tells hypothesis that an input shows a defect."""


class Batch:
    """Inputs of one target from one seed; reports each to `tell`, and the smallest input of each new defect."""

    def __init__(self, target: Target, samples: list[Sample], folder: Path, tell: Any, known: set[str]) -> None:
        self.target, self.samples, self.folder, self.tell, self.known = target, samples, folder, tell, known
        self.hunted: str | None = None
        self.smallest: tuple[Sample, Outcome] | None = None

    def run(self, number: int, count: int, seen: set[bytes]) -> None:
        """Try `count` inputs, fewer where they were `seen` before."""
        limits = settings(
            max_examples=count, database=None, deadline=None, report_multiple_bugs=False,
            phases=(Phase.generate, Phase.shrink), suppress_health_check=list(HealthCheck), print_blob=False,
        )  # fmt: skip

        @seed(number)
        @limits
        @given(inputs(self.samples))
        def try_all(drawn: tuple[int, list[Mutation]]) -> None:
            sample = self.samples[drawn[0]]
            changed = mutate(sample, drawn[1], self.samples)
            mark = hashlib.blake2b(repr((changed.name, sorted(changed.files.items()))).encode(), digest_size=8).digest()
            if self.hunted is None:
                if changed.files == sample.files or mark in seen:
                    return
                seen.add(mark)
            self._try(changed, drawn[1])

        with suppress(_Failure, Flaky):
            try_all()
        if self.smallest is not None:
            self._report(*self.smallest)

    def _try(self, changed: Sample, mutations: list[Mutation]) -> None:
        drawn = {"main": changed.main, "mutations": [astuple(mutation) for mutation in mutations]}
        self.tell({"begin": changed.name, "counts": self.hunted is None, **drawn})
        began = time.monotonic()
        outcome = attempt(self.target, changed, self.folder / "work")
        self.tell({"end": _plain(outcome)})
        if not outcome.is_failure or (self.hunted is None and outcome.where in self.known):
            return
        if self.hunted is None and time.monotonic() - began > MAX_SHRUNK_S:
            self._report(changed, outcome)
            return
        if self.hunted is None:
            self.hunted = outcome.where
        if outcome.where == self.hunted:
            self.smallest = changed, outcome
            raise _Failure

    def _report(self, sample: Sample, outcome: Outcome) -> None:
        self.tell({"defect": _plain(outcome), "sample": self._save(sample)})
        self.known.add(outcome.where)

    def _save(self, sample: Sample) -> dict[str, str]:
        place = self.folder / "smallest" / hashlib.sha1(os.urandom(8)).hexdigest()[:12]
        sample.write(place / "input")
        return {"folder": str(place), "main": sample.main}


def _plain(outcome: Outcome) -> dict[str, str]:
    return {"kind": outcome.kind, "where": outcome.where, "text": outcome.text[-6000:]}


def limit_memory() -> None:
    """Let further memory end at `MEMORY_BYTES` above what the libraries take."""
    with open("/proc/self/statm") as file:
        pages = int(file.read().split()[0])
    limit = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main(corpus: Path, folder: Path) -> None:
    """Serve: a line of JSON on stdin is a batch, `{"target", "seed", "count"}`; lines on stdout tell what happens."""
    out = os.fdopen(os.dup(1), "w")
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(os.open(folder / "stderr.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 2)

    def tell(message: dict[str, Any]) -> None:
        _tell(out, message)

    samples: dict[str, list[Sample]] = {}
    seen: set[bytes] = set()
    known: dict[str, set[str]] = {}
    limit_memory()
    tell({"ready": True})
    for line in sys.stdin:
        order = json.loads(line)
        target = TARGETS[order["target"]]
        if target.name not in samples:
            samples[target.name] = target.samples(corpus)
        known.setdefault(target.name, set()).update(order.get("known", ()))
        began = time.monotonic()
        Batch(target, samples[target.name], folder, tell, known[target.name]).run(order["seed"], order["count"], seen)
        tell({"done": order["seed"], "seconds": time.monotonic() - began})


def _tell(out: TextIO, message: dict[str, Any]) -> None:
    out.write(json.dumps(message) + "\n")
    out.flush()
