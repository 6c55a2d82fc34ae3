"""All scores of one mesh against one reference mesh, and the settings of an evaluation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from scipy.spatial import cKDTree

from ..core.errors import DataError, UncleError
from ..core.mesh import Mesh, PointCloud
from .depth_metrics import NEW_VIEW_PARAMETERS, NovelViewDepth, ViewSettings, novel_view_depth
from .mesh_metrics import MeshMetrics, MeshScoringOptions, color_by_distance, evaluate_mesh, transformed
from .placement import placement_doubts
from .vertex_sigma_metrics import VertexSigmaMetrics, evaluate_vertex_sigma
from .visibility import Visibility

T = TypeVar("T")
MAX_SPACING_SAMPLES = 10_000  # points of a cloud from which its spacing is found


@dataclass(frozen=True)
class EvaluationSettings(MeshScoringOptions):
    """What a user can choose; the defaults are those of `uncle eval`.

    views   new views for the depth error; None: as many as the protocol has, 0: none
    """

    views: int | None = None

    @property
    def view_settings(self) -> ViewSettings:
        """Number, protocol and seed of the new views."""
        default = NEW_VIEW_PARAMETERS[self.protocol].default_views
        return ViewSettings(default if self.views is None else self.views, self.protocol, self.seed)


DEFAULT_SETTINGS = EvaluationSettings()


@dataclass(frozen=True)
class SurfaceMetrics:
    """Scores of one mesh against one reference. `skipped`: part -> why it was not scored; `notes`: what to know of the
    figures, one line each."""

    mesh: MeshMetrics
    novel_views: NovelViewDepth | None
    vertex_sigma: VertexSigmaMetrics | None
    skipped: dict[str, str]
    notes: tuple[str, ...] = ()


def score_surface(
    mesh: Mesh, reference: Mesh | PointCloud, settings: EvaluationSettings, cull: Visibility | None = None
) -> SurfaceMetrics:
    """Score `mesh` against `reference`; with `cull` only what the cameras saw. Raises DataError."""
    visible = cull.is_visible if cull is not None else None
    seen_reference = cull.reference_points(reference) if cull is not None else None
    metrics = evaluate_mesh(mesh, reference, settings, visible=visible, seen_reference=seen_reference)
    skipped: dict[str, str] = {}
    aligned = aligned_as_scored(mesh, metrics)
    novel_views = None
    vertex_sigma = None
    notes = (*placement_doubts(mesh, reference), *((metrics.note,) if metrics.note else ()))
    if isinstance(reference, PointCloud):
        skipped["novel_views"] = "the ground truth is a point cloud, which cannot be rendered"
        skipped["vertex_sigma"] = "the ground truth is a point cloud: distances to it are not those to its surface"
        return SurfaceMetrics(metrics, None, None, skipped, (*notes, _note_on_cloud(reference, metrics)))
    if settings.view_settings.views == 0:
        skipped["novel_views"] = "no views were asked for (--views 0)"
    else:
        novel_views = score_or_skip(
            "novel_views", skipped, lambda: novel_view_depth(aligned, reference, settings.view_settings, seen_reference)
        )
    vertex_sigma = score_or_skip("vertex_sigma", skipped, lambda: evaluate_vertex_sigma(aligned, reference, visible))
    return SurfaceMetrics(metrics, novel_views, vertex_sigma, skipped, notes)


def _note_on_cloud(cloud: PointCloud, metrics: MeshMetrics) -> str:
    """What the points of a cloud mean for the figures: they are the surface only up to their spacing."""
    points = cloud.points[:: max(1, len(cloud.points) // MAX_SPACING_SAMPLES)].astype(np.float64)
    nearest = np.asarray(cKDTree(cloud.points).query(points, k=[min(2, len(cloud.points))])[0])
    return (
        f"the ground truth is a cloud of {len(cloud.points)} points, {metrics.reference_points} of them scored; "
        f"accuracy is measured to the nearest, so the spacing (median {np.median(nearest) * 100:.3g} cm) is part of it"
    )


def aligned_as_scored(mesh: Mesh, metrics: MeshMetrics) -> Mesh:
    """`mesh` as it was scored: moved by ICP where `metrics` were made with it."""
    return transformed(mesh, np.array(metrics.T_reference_mesh)) if metrics.settings.icp else mesh


def write_error_mesh(path: Path, mesh: Mesh, reference: Mesh | PointCloud, metrics: MeshMetrics | None) -> None:
    """Write `mesh`, aligned as it was scored, coloured by its distance to `reference` up to the largest threshold.

    Raises DataError if the mesh was not scored, RunError if the file cannot be written.
    """
    if metrics is None:
        raise DataError(f"{path} is not written: the mesh was not scored, so it has no error to show")
    limit_m = max(score.threshold_m for score in metrics.scores)
    color_by_distance(aligned_as_scored(mesh, metrics), reference, limit_m).save(path)


def score_or_skip(part: str, skipped: dict[str, str], score: Callable[[], T]) -> T | None:
    """The result of `score()`, or None with the reason in `skipped[part]`."""
    try:
        return score()
    except UncleError as error:
        skipped[part] = str(error)
        return None
