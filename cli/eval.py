"""`uncle eval`: scores of a mesh or a trajectory against a ground truth, or of a whole run."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from .console import listener, print_json, print_table
from .options import json_option, run_option, seed_option, wait_option

if TYPE_CHECKING:
    from ..recon.stages.evaluate import EvaluationSettings
    from ..recon.visualization.run_tables import TextTable


# The content tells the format (recon/core/pose_tables.py); the suffix only that it is no mesh.
TRAJECTORY_SUFFIXES = (".txt", ".tum", ".kitti", ".csv", ".log", ".g2o", ".graph", ".poses", ".dat", ".traj", "")


@click.command()
@click.argument("mesh", required=False, type=click.Path(path_type=Path), metavar="[MESH|TRAJECTORY]")
@click.argument("gt", required=False, type=click.Path(path_type=Path))
@run_option
@wait_option
@click.option(
    "--threshold", "thresholds", type=click.FloatRange(0, min_open=True), multiple=True, default=(0.05, 0.02),
    show_default=True, metavar="METRES", help="Distance below which a point counts as correct; repeatable.",
)  # fmt: skip
@click.option(
    "--samples", type=click.IntRange(1), default=250_000, show_default=True,
    help="Points drawn on each mesh, uniformly over its area (protocol `standard`).",
)  # fmt: skip
@seed_option
@click.option(
    "--protocol", type=click.Choice(["standard", "paper"]), default="standard", show_default=True,
    help="`paper`: vertices against sampled clouds after ICP, and 1000 views of 500x500.",
)  # fmt: skip
@click.option(
    "--completeness-to", type=click.Choice(["samples", "surface"]), default="samples", show_default=True,
    help="Recall is measured to the samples of the mesh (usual, depends on --samples) or to its surface.",
)  # fmt: skip
@click.option(
    "--icp/--no-icp", default=None, help="Align the mesh by ICP first.  [default: only with --protocol paper]"
)
@click.option("--cull", metavar="RUN", type=click.Path(path_type=Path), help="Score only what the cameras of RUN saw.")
@click.option(
    "--views", type=click.IntRange(0), metavar="N",
    help="Number of new views for the depth error, 0 for none.  [default: 100; paper: 1000]",
)  # fmt: skip
@click.option(
    "--error-mesh", metavar="FILE", type=click.Path(path_type=Path, dir_okay=False),
    help="Write the mesh coloured by its distance to the ground truth, up to the largest threshold.",
)  # fmt: skip
@click.option(
    "--plot", metavar="FOLDER", type=click.Path(path_type=Path, file_okay=False),
    help="Folder for trajectory.png and drift.png.  [default: RUN/snapshots; two files: not drawn]",
)  # fmt: skip
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    /,
    mesh: Path | None,
    gt: Path | None,
    run_path: Path,
    wait: bool,
    cull: Path | None,
    error_mesh: Path | None,
    plot: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Score MESH against the true mesh or point cloud GT, TRAJECTORY against the true trajectory GT, or a whole run.

    Trajectories are text in the format of TUM, KITTI, EuRoC, RTAB-Map or Open3D (.log). Without arguments the run
    is scored: its mesh (only what the cameras saw), its trajectory and the sigmas of the tracker, depth and colour
    of frames held out of the map, and its uncertainty, as far as the data set has the ground truth. The scores are
    also written to RUN/metrics.json. docs/evaluation.md defines them.

    \b
    uncle eval
    uncle eval mesh.ply truth.ply --cull run
    uncle eval trajectory.txt truth.txt --plot plots
    """
    _check_arguments(mesh, gt, cull, error_mesh, plot)
    if mesh is not None and gt is not None and _are_trajectories(mesh, gt):
        _evaluate_trajectory(ctx, mesh, gt, plot, as_json)
        return
    from ..recon.stages.evaluate import EvaluationSettings

    thresholds = tuple(dict.fromkeys(options.pop("thresholds")))
    settings = EvaluationSettings(thresholds_m=thresholds, **options)
    if mesh is not None and gt is not None:
        _evaluate_mesh(ctx, mesh, gt, settings, cull, error_mesh, as_json)
    else:
        _evaluate_run(ctx, run_path, wait, settings, error_mesh, plot, as_json)


def _check_arguments(
    mesh: Path | None, gt: Path | None, cull: Path | None, error_mesh: Path | None, plot: Path | None
) -> None:
    """Raises UsageError for options that do not go together."""
    if mesh is None:
        if cull is not None:
            raise click.UsageError("--cull needs MESH and GT; a run is always culled by its own cameras")
        return
    if gt is None:
        raise click.UsageError("give both MESH and GT, or neither to score the run")
    if _are_trajectories(mesh, gt):
        if cull is not None or error_mesh is not None:
            raise click.UsageError("--cull and --error-mesh are for meshes, not for trajectories")
    elif plot is not None:
        raise click.UsageError("--plot is for trajectories or a run; for pictures of a mesh use `uncle snapshot`")


def _are_trajectories(first: Path, second: Path) -> bool:
    are_poses = [path.suffix.lower() in TRAJECTORY_SUFFIXES for path in (first, second)]
    if any(are_poses) and not all(are_poses):
        names = ", ".join(suffix for suffix in TRAJECTORY_SUFFIXES if suffix)
        raise click.UsageError(f"cannot score {first} against {second}: give two trajectories ({names}) or two meshes")
    return all(are_poses)


def _evaluate_trajectory(ctx: click.Context, estimate: Path, reference: Path, plot: Path | None, as_json: bool) -> None:
    from ..recon.core.json_values import to_plain
    from ..recon.stages.evaluate import evaluate_trajectory_file
    from ..recon.visualization.run_tables import trajectory_table

    metrics = evaluate_trajectory_file(estimate, reference, plots=plot, on_event=listener(ctx))
    if as_json:
        plain = to_plain(metrics)
        print_json({"estimate_path": str(estimate), "reference_path": str(reference), "trajectory": plain})
    else:
        _print_table(trajectory_table(f"{estimate.name} against {reference.name}", metrics))


def _evaluate_mesh(
    ctx: click.Context, mesh: Path, gt: Path, settings: EvaluationSettings, cull: Path | None,
    error_mesh: Path | None, as_json: bool,
) -> None:  # fmt: skip
    from ..recon.core.json_values import to_plain
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.evaluate import evaluate_mesh_file
    from ..recon.visualization.run_tables import remarks, surface_table

    run = RunDirectory(cull) if cull is not None else None
    metrics = evaluate_mesh_file(mesh, gt, settings, cull=run, error_mesh=error_mesh, on_event=listener(ctx))
    if as_json:
        paths = {"mesh_path": str(mesh), "gt_path": str(gt), "cull": str(cull) if cull is not None else None}
        print_json(paths | to_plain(metrics))
        return
    _print_table(surface_table(f"{mesh.name} against {gt.name}", metrics))
    for line in remarks(metrics.skipped, metrics.notes):
        click.echo(line)


def _evaluate_run(
    ctx: click.Context, run_path: Path, wait: bool, settings: EvaluationSettings, error_mesh: Path | None,
    plot: Path | None, as_json: bool,
) -> None:  # fmt: skip
    from ..recon.core.json_values import to_plain
    from ..recon.run.directory import RunDirectory
    from ..recon.stages.evaluate import evaluate_run
    from ..recon.visualization.run_tables import remarks, run_tables

    run = RunDirectory(run_path, wait)
    summary = evaluate_run(run, settings, error_mesh=error_mesh, plots=plot, on_event=listener(ctx))
    metrics = summary.metrics
    if as_json:
        print_json(to_plain(metrics))
        return
    for table in run_tables(metrics):
        _print_table(table)
    for line in remarks(metrics.skipped, metrics.notes):
        click.echo(line)


def _print_table(table: TextTable) -> None:
    from ..recon.visualization.run_tables import HEADER

    print_table(table.title, HEADER, table.rows)
    if table.footnote:
        click.echo(table.footnote)
