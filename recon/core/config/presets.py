"""Settings that each method starts from, and the models of settings that methods of other packages bring."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .base import Strict
from .nice import PRESETS as NICE_PRESETS
from .senfunet import PRESET as SENFUNET_PRESET
from .vox import PRESET as VOX_PRESET

Preset = Mapping[str, Mapping[str, Any]]  # group -> key -> value

PRESETS: dict[str, Preset] = {
    "uncle": {},
    **NICE_PRESETS,
    "vox-fusion": VOX_PRESET,
    "senfunet": SENFUNET_PRESET,
    "tsdf": {
        "fusion": {"passes": 0},
        "uncertainty": {"enabled": False},
        "photometric": {"enabled": False},
        "field": {"iterations": 0},
    },
}
PLUGIN_MODELS: dict[str, type[Strict]] = {}  # method -> model of its settings `plugin.KEY`


def add_preset(method: str, preset: Preset, plugin_model: type[Strict] | None = None) -> None:
    """Make the settings of a method known, which is of another package or made by a script."""
    PRESETS[method] = preset
    if plugin_model is not None:
        PLUGIN_MODELS[method] = plugin_model


def remove_preset(method: str) -> None:
    """Forget what `add_preset` added."""
    del PRESETS[method]
    PLUGIN_MODELS.pop(method, None)
