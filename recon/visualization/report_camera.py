"""The camera section of a report: the path, its errors, and where tracking was lost."""

from __future__ import annotations

from pathlib import Path

from ..core.errors import DataError
from ..core.html import embed_picture, explain, missing, table
from ..evaluation.run_trajectory import score_tracking, score_trajectory
from ..evaluation.tracking_metrics import describe_lost
from ..evaluation.trajectory_pair import CameraPath
from ..run.directory import RunDirectory
from .trajectory_charts import draw_camera_path
from .trajectory_table import Rows, tracking_rows, trajectory_rows

_HEADER = ("Metric", "Value", "Unit")
_CAPTIONS = {
    "trajectory": "Path of the camera, with equal axes; the estimate is aligned where the true path is known.",
    "drift": "Error over time, with the sigma that the tracker predicts.",
}


def camera_section(run: RunDirectory) -> str:
    """HTML; the charts are also written to the snapshots of the run. Raises DataError, RunError."""
    if not run.trajectory_path.is_file() and not run.tracking_path.is_file():
        return missing(f"There is no trajectory yet; make it with `uncle map --run {run.root}`.")
    tracking = score_tracking(run)
    parts = [explain(describe_lost(tracking))] if tracking is not None else []
    rows: Rows = []
    try:
        rows += trajectory_rows(score_trajectory(run))
    except DataError as error:
        parts.append(missing(f"Not scored: {error}."))
    rows += tracking_rows(tracking) if tracking is not None else []
    parts += [table(_HEADER, rows, numbers=(1,))] if rows else []
    try:
        parts += [_embedded(chart) for chart in draw_camera_path(CameraPath.of_run(run), run.snapshots_path)]
    except DataError as error:
        parts.append(missing(f"Not drawn: {error}."))
    return "\n".join(parts)


def _embedded(chart: Path) -> str:
    return embed_picture(chart.read_bytes(), _CAPTIONS[chart.stem], photographic=False)
