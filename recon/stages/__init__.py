"""The commands of `uncle` as functions: check, run, record in the manifest. One module per command.

Imports every room. `uncle X` is `cli/X.py` (options), `recon/stages/X.py` (files), and one room that does the work.
"""

from typing import TYPE_CHECKING

from ..core.lazy import lazy_names

if TYPE_CHECKING:
    from .base import StageSummary
    from .evaluate import EvaluationSettings, evaluate_mesh_file, evaluate_run, evaluate_trajectory_file
    from .map import load_field, map_run
    from .mesh import mesh_run
    from .preprocess import preprocess_run
    from .report import report_run
    from .snapshot import SnapshotSettings, snapshot_file, snapshot_run
    from .uncertainty import uncertainty_run

__all__ = [
    "EvaluationSettings",
    "SnapshotSettings",
    "StageSummary",
    "evaluate_mesh_file",
    "evaluate_run",
    "evaluate_trajectory_file",
    "load_field",
    "map_run",
    "mesh_run",
    "preprocess_run",
    "report_run",
    "snapshot_file",
    "snapshot_run",
    "uncertainty_run",
]

__getattr__ = lazy_names(
    __name__,
    {
        **dict.fromkeys(("load_field", "map_run"), ".map"),
        "mesh_run": ".mesh",
        "StageSummary": ".base",
        **dict.fromkeys(
            ("EvaluationSettings", "evaluate_mesh_file", "evaluate_run", "evaluate_trajectory_file"), ".evaluate"
        ),
        "preprocess_run": ".preprocess",
        "report_run": ".report",
        **dict.fromkeys(("SnapshotSettings", "snapshot_file", "snapshot_run"), ".snapshot"),
        "uncertainty_run": ".uncertainty",
    },
)
