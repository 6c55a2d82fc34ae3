"""Plane-sweep stereo around the current surface, and the bias and reliability of the depth sensors from it.

Imports sensors and the rooms below it (core, run, volume). Start at `plane_sweep.py` (depth of one view) and
`photometric_depth.py` (of all reference views); `bias_correction.py` and `sensor_reliability.py` compare the sensors
with it.
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .bias_correction import BiasCorrection
    from .photometric_depth import PhotometricDepth
    from .plane_sweep import plane_sweep_depth

__all__ = [
    "BiasCorrection",
    "PhotometricDepth",
    "plane_sweep_depth",
]

__getattr__ = lazy_names(
    __name__,
    {
        "BiasCorrection": ".bias_correction",
        "PhotometricDepth": ".photometric_depth",
        "plane_sweep_depth": ".plane_sweep",
    },
)
