"""The scores of `uncle eval` as tables for people: what the command prints."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..core.number_format import format_cm, format_number, format_percent
from .trajectory_table import tracking_rows, trajectory_rows
from .uncertainty_table import Rows, uncertainty_rows, vertex_sigma_rows

if TYPE_CHECKING:
    from ..evaluation.color_metrics import HeldOutColor
    from ..evaluation.depth_metrics import HeldOutDepth
    from ..evaluation.run_metrics import RunMetrics
    from ..evaluation.surface_metrics import SurfaceMetrics
    from ..evaluation.trajectory_metrics import TrajectoryMetrics

HEADER = ("Metric", "Value", "Unit")


@dataclass(frozen=True)
class TextTable:
    """Rows of (metric, value, unit) under a title; `footnote` is a line below the table."""

    title: str
    rows: Rows
    footnote: str = ""


def run_tables(metrics: RunMetrics) -> Iterator[TextTable]:
    """One table for each part of a run that was scored."""
    from ..evaluation.tracking_metrics import describe_lost

    if metrics.surface is not None:
        yield surface_table("Surface", metrics.surface)
    if metrics.trajectory is not None:
        yield trajectory_table("Trajectory", metrics.trajectory)
    if metrics.tracking is not None:
        yield TextTable("Tracking", tracking_rows(metrics.tracking), describe_lost(metrics.tracking))
    if metrics.held_out:
        rows = [row for held_out in metrics.held_out.values() for row in held_out_rows(held_out)]
        yield TextTable("Depth of held-out frames", rows)
    if metrics.held_out_color is not None:
        yield TextTable("Colour of held-out frames", color_rows(metrics.held_out_color))
    for sensor, uncertainty in metrics.uncertainty.items():
        yield TextTable(f"Uncertainty of {sensor}", uncertainty_rows(uncertainty))


def surface_table(title: str, metrics: SurfaceMetrics) -> TextTable:
    """Scores of a mesh, with the settings they were made with below."""
    return TextTable(title, surface_rows(metrics), f"settings: {describe_settings(metrics)}")


def trajectory_table(title: str, metrics: TrajectoryMetrics) -> TextTable:
    """Scores of a trajectory."""
    return TextTable(title, trajectory_rows(metrics))


def remarks(skipped: dict[str, str], notes: tuple[str, ...]) -> list[str]:
    """One line for each note and each part that was not scored."""
    lines = [f"note: {note}" for note in notes]
    return lines + [f"not scored: {part.replace('_', ' ')}: {reason}" for part, reason in skipped.items()]


def surface_rows(metrics: SurfaceMetrics) -> Rows:
    """Rows in % and cm."""
    mesh = metrics.mesh
    rows: Rows = []
    for score in mesh.scores:
        at = f"at {score.threshold_m * 100:g} cm"
        rows += [
            (f"F-score {at}", format_percent(score.f_score), "%"),
            (f"precision {at}", format_percent(score.precision), "%"),
            (f"recall {at}", format_percent(score.recall), "%"),
        ]
    accuracy = f"{format_cm(mesh.accuracy_mean_m)} / {format_cm(mesh.accuracy_median_m)}"
    completeness = f"{format_cm(mesh.completeness_mean_m)} / {format_cm(mesh.completeness_median_m)}"
    rows += [("accuracy, mean / median", accuracy, "cm"), ("completeness, mean / median", completeness, "cm")]
    if metrics.novel_views is not None:
        depth = metrics.novel_views
        rows += [
            (f"depth L1, {depth.views} new views", format_cm(depth.l1_all_m), "cm"),
            ("depth L1, pixels that show the mesh", format_cm(depth.l1_rendered_m), "cm"),
            ("pixels that show the mesh", format_percent(depth.completeness), "%"),
        ]
    return rows + (vertex_sigma_rows(metrics.vertex_sigma) if metrics.vertex_sigma is not None else [])


def describe_settings(metrics: SurfaceMetrics) -> str:
    """Protocol, seed, alignment, points and culling of a scored mesh, in one line."""
    settings = metrics.mesh.settings
    parts = [settings.protocol, f"seed {settings.seed}", "ICP" if settings.icp else "no ICP"]
    parts += ["vertices" if settings.samples is None else f"{settings.samples} samples"]
    parts += [f"recall to {settings.completeness_to}", "seen parts only" if settings.culled else "whole meshes"]
    return ", ".join(parts)


def held_out_rows(metrics: HeldOutDepth) -> Rows:
    """Rows in cm and %."""
    errors = f"{format_cm(metrics.l1_m)} / {format_cm(metrics.median_m)}"
    return [
        (f"depth L1 to {metrics.sensor}, mean / median", errors, "cm"),
        ("measurements whose pixel shows the mesh", format_percent(metrics.completeness), "%"),
        ("frames", str(metrics.frames), ""),
    ]


def color_rows(metrics: HeldOutColor) -> Rows:
    """Rows in dB and %."""
    return [
        ("PSNR", format_number(metrics.psnr_db, 2), "dB"),
        ("colour L1", format_percent(metrics.l1), "% of full scale"),
        ("pixels that show the mesh", format_percent(metrics.completeness), "%"),
    ]
