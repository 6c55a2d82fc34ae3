"""The `uncle` group: version, verbosity, lazily imported commands, and the one place where errors become messages."""

from __future__ import annotations

import errno
import importlib
import io
import logging
import sys
from contextlib import suppress
from typing import Any

import click

from .process import open_missing_streams, provide_matplotlib_folder

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)

# command -> one-line help. Its module is imported only when the command runs or shows its own help.
COMMANDS: dict[str, str] = {
    "demo": "Make a small room, reconstruct it with two sensors and write a report.",
    "synth": "Make a multi-sensor data set from a furnished room or from a mesh.",
    "inspect": "Check whether depth, colour, poses and clocks of a recording fit.",
    "preprocess": "Read and check a recording and convert it into a run directory.",
    "map": "Reconstruct the scene and learn how far each sensor can be trusted.",
    "mesh": "Extract the surface of a finished map.",
    "eval": "Score a mesh against a ground truth, or a whole run.",
    "uncertainty": "Show how far each sensor of a map can be trusted.",
    "snapshot": "Draw pictures of a mesh or of a run.",
    "report": "Write one HTML page about a run.",
    "pretrain": "Train what some methods bring with them, on scenes made here.",
    "bench": "Run several methods on one protocol and compare them.",
}


class LazyGroup(click.Group):
    """A group that knows its commands' names and one-line helps without importing them.

    lazy: name -> one-line help. The command `name` is `command` in the module of this package that is called
    prefix + name.
    """

    def __init__(self, *args: Any, lazy: dict[str, str], prefix: str = "", **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.lazy, self.prefix = lazy, prefix

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands, in the order of the help."""
        return list(self.lazy)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """Import the module of a command; None if there is no such command."""
        if name not in self.lazy:
            return None
        command: click.Command = importlib.import_module(f".{self.prefix}{name}", __package__).command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the one-line helps, which need no import."""
        with formatter.section("Commands"):
            formatter.write_dl(list(self.lazy.items()))

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the program. Streams that are closed are no error; click ends quietly after `| head`."""
        open_missing_streams()
        provide_matplotlib_folder()
        try:
            return super().main(*args, **kwargs)
        except OSError as error:
            if error.errno not in _FULL or error.filename is not None:  # files name themselves, streams do not
                raise
            with suppress(OSError):
                click.echo(f"Error: cannot write the output: {error.strerror}", err=True)
            sys.stdout = sys.stderr = io.StringIO()  # or Python complains again when it closes them
            sys.exit(1)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; errors meant for people become one line and exit code 1."""
        from ..recon.core.errors import UncleError

        try:
            return super().invoke(ctx)
        except UncleError as error:
            raise click.ClickException(str(error)) from error
        except (ImportError, OSError) as error:
            from ..recon.core.system_check import dependency_error

            explained = dependency_error(error)
            if explained is None:
                raise
            raise click.ClickException(str(explained)) from error
        except KeyboardInterrupt as interrupt:
            click.echo("Stopped. What was finished is kept; run the same command again to go on.", err=True)
            raise SystemExit(130) from interrupt


def _show_version(ctx: click.Context, _: click.Parameter, is_wanted: bool) -> None:
    if is_wanted and not ctx.resilient_parsing:
        from ..recon import __version__

        click.echo(f"uncle, version {__version__}")
        ctx.exit()


@click.group(
    cls=LazyGroup, lazy=COMMANDS, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110}
)  # fmt: skip
@click.option(
    "--version", is_flag=True, expose_value=False, is_eager=True, callback=_show_version,
    help="Show the version and exit.",
)  # fmt: skip
@click.option("-v", "--verbose", is_flag=True, help="Say more on stderr.")
@click.option("-q", "--quiet", is_flag=True, help="Say only errors.")
@click.pass_context
def main(ctx: click.Context, verbose: bool, quiet: bool) -> None:
    """Turn recorded RGB-D sequences of one or several depth sensors into a mesh and a statement of trust.

    \b
    uncle preprocess DATASET
    uncle map --sensors sl psmnet
    uncle mesh
    uncle eval
    """
    ctx.obj = {"quiet": quiet}
    logging.basicConfig(
        format="%(levelname)s: %(message)s",
        level=logging.DEBUG if verbose else logging.ERROR if quiet else logging.WARNING,
    )


if __name__ == "__main__":
    main(prog_name="uncle")
