"""What the benchmark knows of the methods: facts that the caller hands in, and the comparisons of the paper."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

BASELINE = "tsdf"  # every time is also given as a multiple of its time
UNWEIGHTED = "nice-slam"  # the paper's system with unit weights, the reference of its uncertainty


class MethodFacts(Protocol):
    """The part of `recon.methods.spec.MethodSpec` that the benchmark reads."""

    @property
    def is_deterministic(self) -> bool:
        """Whether all seeds give the same map where poses are given."""

    @property
    def bench_given_only(self) -> str:
        """Why the method is benchmarked with given poses alone; "" if it tracks as well."""

    @property
    def bench_settings(self) -> Mapping[str, tuple[str, ...]]:
        """Settings (KEY=VALUE) of the method by setting of the benchmark."""


@dataclass(frozen=True)
class Catalogue:
    """Facts by method, in the order of the tables. A method without facts can do everything and draws at random."""

    facts: Mapping[str, MethodFacts] = field(default_factory=dict)

    def in_order(self, names: Iterable[str]) -> list[str]:
        """`names` without repetition, in the order of the tables."""
        order = list(self.facts)
        return sorted(set(names), key=lambda name: (order.index(name) if name in order else len(order), name))

    def why_not(self, method: str, setting: str) -> str | None:
        """Why a table has no figures for `method` in this setting; None if it can do it."""
        if setting == "given" or method not in self.facts:
            return None
        return self.facts[method].bench_given_only or None

    def settings_of(self, method: str, setting: str) -> tuple[str, ...]:
        """Settings (KEY=VALUE) of `method` in this setting of the benchmark; a user's --set comes after them."""
        return self.facts[method].bench_settings.get(setting, ()) if method in self.facts else ()

    def runs_of(self, method: str, setting: str, seeds: int) -> int:
        """The number of seeds to run: one where nothing is drawn at random."""
        deterministic = method in self.facts and self.facts[method].is_deterministic
        return 1 if deterministic and setting == "given" else seeds


def tested_pairs(methods: list[str]) -> list[tuple[str, str]]:
    """(method, against): the paper's pair first, then every other method against it and ours against all."""
    pairs = [(method, UNWEIGHTED) for method in ("uncle-paper", *methods) if method != UNWEIGHTED]
    pairs += [("uncle", method) for method in methods if method != "uncle"]
    return [pair for pair in dict.fromkeys(pairs) if set(pair) <= set(methods)]
