"""What is known of one depth sensor: error scale per measurement, fusion weight, faults.

Imports core, run and volume. Start at `noise_model.py` (the network h_w from image to beta), `noise_inputs.py` (what it
sees) and `likelihood.py` (what it minimises); `fusion_weights.py` turns beta into weights, `fault_detection.py` finds
sensors that fail.
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .fault_detection import FaultDetector
    from .fusion_weights import FusionWeights
    from .likelihood import laplace_nll, quantile_loss
    from .noise_inputs import SENSOR_INPUTS, pixel_inputs
    from .noise_maps import load_noise_models, predict_beta
    from .noise_model import NoiseModel, Residuals
    from .noise_prior import NoisePrior, save_noise_models

__all__ = [
    "SENSOR_INPUTS",
    "FaultDetector",
    "FusionWeights",
    "NoiseModel",
    "NoisePrior",
    "Residuals",
    "laplace_nll",
    "load_noise_models",
    "pixel_inputs",
    "predict_beta",
    "quantile_loss",
    "save_noise_models",
]

__getattr__ = lazy_names(
    __name__,
    {
        "FaultDetector": ".fault_detection",
        "FusionWeights": ".fusion_weights",
        **dict.fromkeys(("quantile_loss", "laplace_nll"), ".likelihood"),
        **dict.fromkeys(("SENSOR_INPUTS", "pixel_inputs"), ".noise_inputs"),
        **dict.fromkeys(("load_noise_models", "predict_beta"), ".noise_maps"),
        **dict.fromkeys(("NoiseModel", "Residuals"), ".noise_model"),
        **dict.fromkeys(("NoisePrior", "save_noise_models"), ".noise_prior"),
    },
)
