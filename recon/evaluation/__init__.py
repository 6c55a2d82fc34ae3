"""Scores against ground truth. Never read by a method.

Imports sensors, run and core, never volume. Start at `run_metrics.py` (all scores of one run); `bench/` makes many runs
as processes.
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .mesh_metrics import evaluate_mesh
    from .run_metrics import RunMetrics, score_run
    from .surface_metrics import EvaluationSettings, score_surface
    from .trajectory_metrics import evaluate_trajectory
    from .uncertainty_calibration import evaluate_uncertainty

__all__ = [
    "EvaluationSettings",
    "RunMetrics",
    "evaluate_mesh",
    "evaluate_trajectory",
    "evaluate_uncertainty",
    "score_run",
    "score_surface",
]

__getattr__ = lazy_names(
    __name__,
    {
        "evaluate_mesh": ".mesh_metrics",
        **dict.fromkeys(("RunMetrics", "score_run"), ".run_metrics"),
        **dict.fromkeys(("EvaluationSettings", "score_surface"), ".surface_metrics"),
        "evaluate_trajectory": ".trajectory_metrics",
        "evaluate_uncertainty": ".uncertainty_calibration",
    },
)
