"""Variants of the uncertainty for ablations: a name and the settings that make it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

from ...core.errors import ConfigError

UNWEIGHTED = "unweighted"
Settings = tuple[str, ...]  # key=value, as `uncle map --set` takes them
_TWO, _SEVEN = ("depth", "incidence"), ("depth", "incidence", "slope_x", "slope_y")
_PATCH = {kind: tuple(f"{kind}_{window}" for window in (3, 7)) for kind in ("spread", "offset", "holes")}


class Variant(NamedTuple):
    """`name`: `settings` on top of the preset of `method`."""

    method: str
    name: str
    settings: Settings


def _features(*names: str) -> str:
    return f"uncertainty.inputs={json.dumps(names)}"


def _paper_variants() -> dict[str, Settings]:
    """The paper's eight variants in the default method: patch of 1 or 5, 2 or 7 features, small or large beta_min.

    Spread, offset and holes of the depth in a window stand for the patch; incidence and both slopes for the normal.
    """
    patch = tuple(name for names in _PATCH.values() for name in names)
    seen = {"1K2F": _TWO, "1K7F": _SEVEN, "5K2F": (*_TWO, *patch), "5K7F": (*_SEVEN, *patch, "bend")}
    small_large = {"S": "uncertainty.beta_min_m=1e-3", "L": "uncertainty.beta_min_m=1e-1"}
    return {f"{a}{b}": (_features(*seen[a]), small_large[b]) for a, b in product(seen, small_large)}


def _of_the_papers_network() -> dict[str, Settings]:
    """The same eight in the paper's own system, where the patch itself is the input of h_w."""
    choices = product((1, 5), (2, 7), (("S", "1e-3"), ("L", "1e-1")))
    return {
        f"h_w {patch}K{count}F{size}": (
            f"nice.noise_patch={patch}",
            f"nice.noise_features={count}",
            f"nice.beta_min_m={beta_min}",
        )
        for patch, count, (size, beta_min) in choices
    }


GROUPS: dict[str, dict[str, Settings]] = {
    "paper": _paper_variants(),
    "uncle-paper": _of_the_papers_network(),
    "own": {
        "uncle": (),
        "two inputs": (_features(*_TWO),),
        "hidden 8": ("uncertainty.hidden=8",),
        "hidden 64": ("uncertainty.hidden=64",),
        "fusion.passes 0": ("fusion.passes=0",),
        "one photometric pass": ("photometric.max_passes=1",),
        "one photometric pass, fusion.passes 2": ("photometric.max_passes=1", "fusion.passes=2"),
        "reliability off": ("photometric.estimate_reliability=false",),
        "photometric depth off": ("photometric.enabled=false",),
        "quarter of the steps": ("uncertainty.steps_per_pass=100",),
        "discretisation term 0": ("fusion.discretisation_voxels=0",),
        "beta_min 1 cm": ("uncertainty.beta_min_m=1e-2",),
        "no refinement": ("field.iterations=0",),
    },
}
# Method of the groups that do not use the default method.
METHOD_OF = {"uncle-paper": "uncle-paper"}
# Settings of each method that give all measurements the same weight.
_UNWEIGHTED_BY: dict[str, Settings] = {
    "uncle": ("uncertainty.enabled=false",),
    "uncle-paper": ("nice.weighting=uniform",),
}


def choose_variants(names: Sequence[str], added: Sequence[Sequence[str]] = ()) -> dict[str, Settings]:
    """Settings of each variant of the default method in `names` (groups or variants), the unweighted one first.

    `added` are further variants as (name, setting, ...). Raises ConfigError for unknown names and those of another
    method.
    """
    others = [name for name in names if name in METHOD_OF or any(name in GROUPS[group] for group in METHOD_OF)]
    if others:
        raise ConfigError(f"{others[0]!r} is of another method; run it with `uncle bench paper --ablation`")
    chosen = {variant.name: variant.settings for variant in variants_of_methods(names) if variant.method == "uncle"}
    return {UNWEIGHTED: _UNWEIGHTED_BY["uncle"]} | chosen | {name: tuple(settings) for name, *settings in added}


def variants_of_methods(names: Sequence[str]) -> list[Variant]:
    """The variants in `names` (groups or variants); for each method the unweighted one first.

    Raises ConfigError for unknown names.
    """
    known = {name: group for group, variants in GROUPS.items() for name in variants}
    chosen: dict[str, dict[str, Settings]] = {}
    for name in names:
        group = name if name in GROUPS else known.get(name)
        if group is None and name != UNWEIGHTED:
            raise ConfigError(f"no variant or group is called {name!r}; there are {', '.join((*GROUPS, *known))}")
        method = METHOD_OF.get(group or "", "uncle")
        of_method = chosen.setdefault(method, {UNWEIGHTED: _UNWEIGHTED_BY[method]})
        if group is not None:
            of_method |= GROUPS[group] if name in GROUPS else {name: GROUPS[group][name]}
    return [Variant(method, *item) for method, variants in chosen.items() for item in variants.items()]
