"""`uncle eval`: scores of a mesh or a trajectory against a ground truth, or of a whole run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .console import listener, print_json, print_table
from .options import json_option, run_option, seed_option

if TYPE_CHECKING:
    from ..recon.evaluation.color_metrics import HeldOutColor
    from ..recon.evaluation.depth_metrics import HeldOutDepth
    from ..recon.evaluation.run_metrics import EvalSettings, RunMetrics, SurfaceMetrics
    from ..recon.evaluation.trajectory_pair import CameraPath

HEADER = ("Metric", "Value", "Unit")
Rows = list[tuple[str, str, str]]


@click.command()
@click.argument("mesh", required=False, type=click.Path(path_type=Path), metavar="[MESH|TRAJECTORY]")
@click.argument("gt", required=False, type=click.Path(path_type=Path))
@run_option
@click.option(
    "--threshold", "thresholds", type=click.FloatRange(0, min_open=True), multiple=True, default=(0.05, 0.02),
    show_default=True, metavar="METRES", help="Distance that counts as right; may be given several times.",
)  # fmt: skip
@click.option(
    "--samples", type=click.IntRange(1), default=250_000, show_default=True,
    help="Points drawn on each mesh, uniformly over its area (protocol `standard`).",
)  # fmt: skip
@seed_option
@click.option(
    "--protocol", type=click.Choice(["standard", "paper"]), default="standard", show_default=True,
    help="`paper`: vertices against sampled clouds after ICP, and 1000 views of 500x500, as published scripts do.",
)  # fmt: skip
@click.option(
    "--completeness-to", type=click.Choice(["samples", "surface"]), default="samples", show_default=True,
    help="What recall is measured to: the samples of the mesh (usual; depends on --samples) or its surface.",
)  # fmt: skip
@click.option("--icp/--no-icp", default=None, help="Align the mesh first. [default: only with --protocol paper]")
@click.option("--cull", metavar="RUN", type=click.Path(path_type=Path), help="Score only what the cameras of RUN saw.")
@click.option(
    "--views", type=click.IntRange(0), metavar="N",
    help="New views for the depth error, 0 for none. [default: 100, paper 1000]",
)  # fmt: skip
@click.option(
    "--error-mesh", metavar="FILE.ply", type=click.Path(path_type=Path, dir_okay=False),
    help="Write the mesh coloured by its distance to the ground truth, up to the largest threshold.",
)  # fmt: skip
@click.option(
    "--plot", metavar="FOLDER", type=click.Path(path_type=Path, file_okay=False),
    help="Where to write trajectory.png and drift.png. [default: RUN/snapshots; none for two files]",
)  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    mesh: Path | None,
    gt: Path | None,
    run_path: Path,
    cull: Path | None,
    error_mesh: Path | None,
    plot: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Score MESH against the ground-truth mesh GT, or without them everything that a run holds.

    TRAJECTORY and GT may also be two files of TUM text (.txt). A run is scored on its mesh (only what the cameras
    saw), its trajectory and what the tracker says of it, depth and colour of frames held out of the map, and its
    uncertainty, each where the data set has the truth; the figures also go to RUN/metrics.json.
    """
    if mesh is not None and gt is None:
        raise click.UsageError("give both MESH and GT, or neither to score the run")
    if mesh is None and cull is not None:
        raise click.UsageError("--cull goes with MESH and GT; a run is always culled by its own cameras")
    if mesh is not None and gt is not None and _are_trajectories(mesh, gt):
        if cull is not None or error_mesh is not None:
            raise click.UsageError("--cull and --error-mesh go with meshes, not with trajectories")
        _evaluate_trajectory(ctx, mesh, gt, plot, as_json)
        return
    if mesh is not None and plot is not None:
        raise click.UsageError("--plot goes with trajectories or a run; for pictures of a mesh see `uncle snapshot`")
    from ..recon.evaluation.run_metrics import EvalSettings

    thresholds = tuple(dict.fromkeys(options.pop("thresholds")))
    settings = EvalSettings(thresholds_m=thresholds, **options)
    if mesh is not None and gt is not None:
        _evaluate_mesh(mesh, gt, settings, cull, error_mesh, as_json)
    else:
        _evaluate_run(ctx, run_path, settings, error_mesh, plot, as_json)


def _are_trajectories(first: Path, second: Path) -> bool:
    texts = [path.suffix.lower() == ".txt" for path in (first, second)]
    if any(texts) and not all(texts):
        raise click.UsageError("a trajectory (.txt) is scored against a trajectory (.txt), a mesh against a mesh")
    return all(texts)


def _evaluate_trajectory(ctx: click.Context, estimate: Path, reference: Path, plot: Path | None, as_json: bool) -> None:
    from ..recon.core.json_values import to_plain
    from ..recon.evaluation.trajectory_metrics import evaluate_trajectory
    from ..recon.evaluation.trajectory_pair import CameraPath
    from ..recon.visualization.trajectory_table import trajectory_rows

    path = CameraPath.of_files(estimate, reference)
    metrics = evaluate_trajectory(path.estimate, path.reference)
    if plot is not None:
        _plot(ctx, path, plot)
    if as_json:
        plain = to_plain(metrics)
        print_json({"estimate_path": str(estimate), "reference_path": str(reference), "trajectory": plain})
        return
    print_table(f"{estimate.name} against {reference.name}", HEADER, trajectory_rows(metrics))


def _plot(ctx: click.Context, path: CameraPath, folder: Path) -> None:
    from ..recon.core.events import Note
    from ..recon.visualization.trajectory_charts import draw_camera_path

    drawn = draw_camera_path(path, folder)
    listener(ctx)(Note(f"drawn: {', '.join(map(str, drawn))}"))


def _evaluate_mesh(
    mesh_path: Path, gt_path: Path, settings: EvalSettings, cull: Path | None, error_mesh: Path | None, as_json: bool
) -> None:
    from ..recon.core.json_values import to_plain
    from ..recon.core.mesh import Mesh
    from ..recon.evaluation.run_metrics import score_surface, write_error_mesh
    from ..recon.evaluation.visibility import Visibility
    from ..recon.run.directory import RunDirectory

    mesh, reference = Mesh.load(mesh_path), Mesh.load(gt_path)
    visibility = Visibility.of_run(RunDirectory(cull)) if cull is not None else None
    metrics = score_surface(mesh, reference, settings, visibility)
    if error_mesh is not None:
        write_error_mesh(error_mesh, mesh, reference, metrics.mesh)
    if as_json:
        print_json(
            {"mesh_path": str(mesh_path), "gt_path": str(gt_path), "cull": cull and str(cull), **to_plain(metrics)}
        )
        return
    print_table(f"{mesh_path.name} against {gt_path.name}", HEADER, surface_rows(metrics))
    click.echo(f"settings: {_describe(metrics)}")
    _print_remarks(metrics.skipped, (metrics.mesh.note,) if metrics.mesh.note else ())


def _evaluate_run(
    ctx: click.Context,
    run_path: Path,
    settings: EvalSettings,
    error_mesh: Path | None,
    plot: Path | None,
    as_json: bool,
) -> None:
    from ..recon.core.errors import DataError
    from ..recon.core.events import Warn
    from ..recon.core.json_values import to_plain
    from ..recon.core.mesh import Mesh
    from ..recon.evaluation.run_metrics import evaluate_run, load_reference, write_error_mesh
    from ..recon.evaluation.trajectory_pair import CameraPath
    from ..recon.run.directory import RunDirectory

    run = RunDirectory(run_path)
    metrics = evaluate_run(run, settings, listener(ctx))
    metrics.save(run.metrics_path)
    if error_mesh is not None:
        reference = load_reference(run.manifest)
        write_error_mesh(error_mesh, Mesh.load(run.mesh_path), reference, metrics.surface and metrics.surface.mesh)
    if metrics.trajectory is not None or metrics.tracking is not None:
        try:
            _plot(ctx, CameraPath.of_run(run), plot or run.snapshots_path)
        except DataError as error:
            listener(ctx)(Warn(f"the camera is not drawn: {error}"))
    if as_json:
        print_json(to_plain(metrics))
        return
    _print_run(metrics)


def _print_run(metrics: RunMetrics) -> None:
    from ..recon.evaluation.tracking_metrics import describe_lost
    from ..recon.visualization.trajectory_table import tracking_rows, trajectory_rows
    from ..recon.visualization.uncertainty_table import uncertainty_rows

    if metrics.surface is not None:
        print_table("Surface", HEADER, surface_rows(metrics.surface))
        click.echo(f"settings: {_describe(metrics.surface)}")
    if metrics.trajectory is not None:
        print_table("Trajectory", HEADER, trajectory_rows(metrics.trajectory))
    if metrics.tracking is not None:
        print_table("Tracking", HEADER, tracking_rows(metrics.tracking))
        click.echo(describe_lost(metrics.tracking))
    if metrics.held_out:
        rows = [row for held_out in metrics.held_out.values() for row in held_out_rows(held_out)]
        print_table("Depth of held-out frames", HEADER, rows)
    if metrics.held_out_color is not None:
        print_table("Colour of held-out frames", HEADER, color_rows(metrics.held_out_color))
    for sensor, uncertainty in metrics.uncertainty.items():
        print_table(f"Uncertainty of {sensor}", HEADER, uncertainty_rows(uncertainty))
    _print_remarks(metrics.skipped, metrics.notes)


def _print_remarks(skipped: dict[str, str], notes: tuple[str, ...]) -> None:
    for note in notes:
        click.echo(f"note: {note}")
    for part, reason in skipped.items():
        click.echo(f"not scored: {part.replace('_', ' ')}: {reason}")


def surface_rows(metrics: SurfaceMetrics) -> Rows:
    """Rows in % and cm."""
    from ..recon.visualization.uncertainty_table import vertex_sigma_rows

    mesh, rows = metrics.mesh, []
    for score in mesh.scores:
        at = f"at {score.threshold_m * 100:g} cm"
        rows += [
            (f"F-score {at}", _percent(score.f_score), "%"),
            (f"precision {at}", _percent(score.precision), "%"),
            (f"recall {at}", _percent(score.recall), "%"),
        ]
    rows += [
        ("accuracy, mean / median", f"{_cm(mesh.accuracy_mean_m)} / {_cm(mesh.accuracy_median_m)}", "cm"),
        ("completeness, mean / median", f"{_cm(mesh.completeness_mean_m)} / {_cm(mesh.completeness_median_m)}", "cm"),
    ]
    if metrics.novel_views is not None:
        depth = metrics.novel_views
        rows += [
            (f"depth L1, {depth.views} new views", _cm(depth.l1_all_m), "cm"),
            ("depth L1 where the mesh is", _cm(depth.l1_rendered_m), "cm"),
            ("share of pixels where the mesh is", _percent(depth.completeness), "%"),
        ]
    return rows + (vertex_sigma_rows(metrics.vertex_sigma) if metrics.vertex_sigma is not None else [])


def _describe(metrics: SurfaceMetrics) -> str:
    settings = metrics.mesh.settings
    parts = [settings.protocol, f"seed {settings.seed}", "ICP" if settings.icp else "no ICP"]
    parts += ["vertices" if settings.samples is None else f"{settings.samples} samples"]
    parts += [f"recall to {settings.completeness_to}", "seen parts only" if settings.culled else "whole meshes"]
    return ", ".join(parts)


def held_out_rows(metrics: HeldOutDepth) -> Rows:
    """Rows in cm and %."""
    return [
        (f"L1 to {metrics.sensor}, mean / median", f"{_cm(metrics.l1_m)} / {_cm(metrics.median_m)}", "cm"),
        ("share of readings where the mesh is", _percent(metrics.completeness), "%"),
        ("frames", str(metrics.frames), ""),
    ]


def color_rows(metrics: HeldOutColor) -> Rows:
    """Rows in dB and %."""
    return [
        ("PSNR", "-" if metrics.psnr_db is None else f"{metrics.psnr_db:.2f}", "dB"),
        ("L1", "-" if metrics.l1 is None else _percent(metrics.l1), "% of full scale"),
        ("share of pixels where the mesh is", _percent(metrics.completeness), "%"),
    ]


def _cm(metres: float | None) -> str:
    return "-" if metres is None else f"{metres * 100:.2f}"


def _percent(ratio: float) -> str:
    return f"{ratio * 100:.2f}"
