"""`uncle bench paper`: the paper's tables, and our method beside its."""

from __future__ import annotations

from pathlib import Path

import click

from .console import listener
from .options import SensorsCommand, device_option

SETTINGS = ("given", "depth", "rgbd")


class _PaperCommand(SensorsCommand):
    several = ("--sensors", "--methods", "--settings", "--ablation")


@click.command("paper", cls=_PaperCommand)
@click.argument("datasets", nargs=-1, required=True, metavar="DATASET...")
@click.option("--methods", multiple=True, metavar="NAME [NAME ...]",
              help="Methods of `uncle map`, in any order. Default: all of them.")  # fmt: skip
@click.option("--sensors", multiple=True, metavar="NAME[+NAME] ...",
              help="Sets, like: sl sl+psmnet. Default: each sensor, and the paper's or else all pairs.")  # fmt: skip
@click.option("--settings", type=click.Choice(SETTINGS), multiple=True, default=SETTINGS, show_default=True,
              help="Given poses, tracking by depth alone, tracking by colour and depth.")  # fmt: skip
@click.option("--ablation", multiple=True, metavar="NAME [NAME ...]",
              help="Also variants of the uncertainty: groups (paper, own, uncle-paper) or single ones.")  # fmt: skip
@click.option("--seeds", type=click.IntRange(1), default=3, show_default=True, metavar="N",
              help="Number of seeds, from 0.")  # fmt: skip
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE",
              help="Change a setting of every method, as in `uncle map`; METHOD:KEY=VALUE of one.")  # fmt: skip
@click.option("--frames", default="", metavar="START:STOP:STEP", help="Frames of every data set; all if not given.")
@click.option("--protocol", type=click.Choice(["standard", "paper"]), default="standard", show_default=True,
              help="Protocol of `uncle eval`.")  # fmt: skip
@device_option
@click.option("--jobs", type=click.IntRange(1), default=1, show_default=True, metavar="N",
              help="Runs at the same time; they share the cores evenly.")  # fmt: skip
@click.option("--keep-runs", is_flag=True, help="Keep maps and meshes, not only figures and logs.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), default=Path("bench-out"),
              show_default="./bench-out", help="Folder of the results; a second call with it goes on.")  # fmt: skip
@click.pass_context
def command(
    ctx: click.Context, datasets: tuple[str, ...], methods: tuple[str, ...], sensors: tuple[str, ...],
    settings: tuple[str, ...], ablation: tuple[str, ...], seeds: int, overrides: tuple[str, ...], frames: str,
    protocol: str, device: str, jobs: int, keep_runs: bool, out: Path,
) -> None:  # fmt: skip
    """The paper's tables: every method on every DATASET, with one and two sensors, with given poses and tracking.

    DATASET is a folder as for `uncle preprocess`, or a room made on demand: synth:SEED, with choices as in
    synth:7,frames=60,size=128,sensors=sl+sgm. Results are written to OUT after every run; what is there is not run
    again. A run that fails is reported in the tables and stops nothing. docs/bench.md says how to read them.

    \b
    uncle bench paper rooms/living_room --sensors sl psmnet sl+psmnet --seeds 5
    uncle bench paper synth:7 synth:8 --methods uncle uncle-paper nice-slam tsdf --settings given
    """
    from ..recon.evaluation.bench.methods import Catalogue
    from ..recon.evaluation.bench.paper import Bench, run_paper
    from ..recon.evaluation.bench.paper_tables import DETAILS
    from ..recon.evaluation.bench.plan import Choice
    from ..recon.evaluation.bench.variants import variants_of_methods
    from ..recon.methods.registry import method_spec, method_specs

    specs = method_specs()
    chosen = methods or tuple(specs)
    variants = tuple(variants_of_methods(ablation))
    choice = Choice(chosen, settings, sensors, seeds, overrides, protocol, device, variants, Catalogue(specs))
    for method in chosen:
        method_spec(method).configure(list(choice.overrides_of(method)))  # an unknown method or setting is told at once
    bench = Bench(out, jobs, keep_runs, frames)
    tables, failed = run_paper(bench, datasets, choice, listener(ctx))
    click.echo("\n\n".join(table.markdown() for table in tables if table.title != DETAILS))
    click.echo(f"Tables: {out / 'paper.md'}, {out / 'paper.html'}; figures: {out / 'paper.json'}", err=True)
    if failed:
        raise click.ClickException(
            f"{len(failed)} of the runs failed; the tables say why. The same command tries them again"
        )
