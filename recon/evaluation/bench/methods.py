"""Which methods there are, and which of them cannot do what."""

from __future__ import annotations

from ...core.config.presets import PRESETS

BASELINE = "tsdf"  # every time is also given as a multiple of its time
UNWEIGHTED = "nice-slam"  # the paper's system with unit weights: what its uncertainty is tested against
_ORDER = ("uncle", "uncle-paper", UNWEIGHTED, "nice-slam-pre", "vox-fusion", "senfunet", BASELINE)
_GIVEN_ONLY = {"senfunet": "it fuses with given poses and has no tracker"}
_SEEDLESS = frozenset({BASELINE, "senfunet"})  # nothing is drawn with given poses: one run says all
# The paper's depth-only rows know no colour, in mapping neither; what else a method does in a setting
_SETTINGS = {("depth", method): ("nice.color=false",) for method in ("uncle-paper", UNWEIGHTED, "nice-slam-pre")}


def known_methods() -> list[str]:
    """Every preset, in the order of the tables."""
    return sorted(PRESETS, key=lambda name: (_ORDER.index(name) if name in _ORDER else len(_ORDER), name))


def why_not(method: str, setting: str) -> str | None:
    """Why a table has no figures for `method` in this setting; None if it can do it."""
    return _GIVEN_ONLY.get(method) if setting != "given" else None


def settings_of(method: str, setting: str) -> tuple[str, ...]:
    """What `method` is told in this setting beside the options of all methods; a user's --set comes after it."""
    return _SETTINGS.get((setting, method), ())


def runs_of(method: str, setting: str, seeds: int) -> int:
    """How many seeds are worth running."""
    return 1 if method in _SEEDLESS and setting == "given" else seeds


def tested_pairs(methods: list[str]) -> list[tuple[str, str]]:
    """(method, against): the paper's pair first, then every other method against it and ours against all."""
    pairs = [(method, UNWEIGHTED) for method in ("uncle-paper", *methods) if method != UNWEIGHTED]
    pairs += [("uncle", method) for method in methods if method != "uncle"]
    return [pair for pair in dict.fromkeys(pairs) if set(pair) <= set(methods)]
