"""Settings that each method starts from."""

from __future__ import annotations

from typing import Any

from .nice import PRESETS as NICE_PRESETS
from .senfunet import PRESET as SENFUNET_PRESET
from .vox import PRESET as VOX_PRESET

PRESETS: dict[str, dict[str, Any]] = {
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
