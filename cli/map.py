"""`uncle map`: reconstruct the scene and learn how far each sensor can be trusted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ..recon.core.events import Warn
from ..recon.methods.registry import DEFAULT_METHOD, method_spec, method_specs, plugin_problems
from .console import listener
from .options import (
    SensorsCommand,
    device_option,
    overwrite_option,
    run_option,
    seed_option,
    sensors_option,
    wait_option,
)


class _MethodName(click.Choice[str]):
    """The name of a method; those of installed packages among them."""

    name = "method"

    def __init__(self) -> None:
        self.specs = method_specs()
        super().__init__(list(self.specs))

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        if ctx is not None:
            for problem in plugin_problems():
                listener(ctx)(Warn(problem))
        return super().convert(value, param, ctx)

    def help(self) -> str:
        """A sentence on each method."""
        return "; ".join(f"{spec.name}: {spec.summary}" for spec in self.specs.values()) + "."


_METHOD = _MethodName()


@click.command("map", cls=SensorsCommand)
@run_option
@wait_option
@sensors_option("Sensors to use. Default: all but the ground truth.")
@click.option("--method", type=_METHOD, default=DEFAULT_METHOD, show_default=True, help=_METHOD.help())
@click.option("--track", is_flag=True,
              help="Estimate the camera of every frame; without it the poses are those of the data set.")  # fmt: skip
@click.option("--color/--no-color", default=True, show_default=True,
              help="Track by colour and depth, or by depth alone.")  # fmt: skip
@click.option("--voxel", type=click.FloatRange(0.001, 0.5), default=None, metavar="METRES",
              help="Voxel size. Default: chosen from the depth of the recording; 2 cm for rooms.")  # fmt: skip
@click.option("--hold-out", type=click.IntRange(2), default=None, metavar="N",
              help="Keep every N-th frame out of the map; `uncle eval` scores it.")  # fmt: skip
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a setting (docs/config.md).")
@click.option("--prior", type=click.Path(path_type=Path), default=None, metavar="MODEL|RUN",
              help="Start from what another run learned about its sensors: a run or its noise_model.pt.")  # fmt: skip
@seed_option
@device_option
@click.option("--resume", is_flag=True, help="Continue an interrupted map; ends in the same result.")
@overwrite_option
@click.pass_context
def command(
    ctx: click.Context, run_path: Path, wait: bool, sensors: tuple[str, ...], method: str, track: bool, color: bool,
    voxel: float | None, hold_out: int | None, overrides: tuple[str, ...], prior: Path | None, seed: int, device: str,
    resume: bool, overwrite: bool,
) -> None:  # fmt: skip
    """Reconstruct the scene and learn how far each sensor can be trusted.

    \b
    uncle map --sensors sl psmnet --track
    uncle map --method tsdf --set fusion.voxel_size_m=0.01
    uncle map --prior yesterday/run
    """
    from ..recon.core.events import Note
    from ..recon.run.directory import RunDirectory
    from ..recon.sensors.noise_prior import NoisePrior
    from ..recon.stages.map import map_run

    if not color and not track:
        raise click.UsageError("--no-color is about tracking; add --track")
    settings = [f"tracking.enabled={str(track).lower()}", f"tracking.color={str(color).lower()}", *overrides]
    settings += [f"fusion.voxel_size_m={voxel}"] if voxel is not None else []
    spec = method_spec(method)
    config = spec.configure(settings, sensors=sensors, seed=seed, device=device, hold_out=hold_out or 0)
    say = listener(ctx)
    known = NoisePrior.load(prior) if prior is not None else None
    run = RunDirectory(run_path, wait)
    summary = map_run(run, config, prior=known, resume=resume, overwrite=overwrite, on_event=say)
    if summary.unchanged:
        say(Note(f"The map of {run_path} is done and unchanged; --overwrite redoes it."))
        return
    rate = summary.frames / max(summary.seconds, 1e-9)
    figures = f"{summary.seconds:.1f} s ({rate:.1f} frames/s, {summary.peak_memory_mb:.0f} MB at most)"
    say(Note(f"Mapped {summary.frames} frames in {figures}. Next: uncle mesh --run {run_path}"))
