"""`make demo` gives `uncle demo` arguments that it takes."""

import re
from pathlib import Path

from click.testing import CliRunner
from uncle.cli.demo import command

MAKEFILE = Path(__file__).parent.parent / "Makefile"


def test_the_demo_command_of_the_makefile_parses():
    recipe = re.search(r"BIN\)/uncle demo(.*)$", MAKEFILE.read_text(), re.MULTILINE)
    arguments = recipe.group(1).replace("$(DEMO)", "demo").split()
    context = command.make_context("demo", arguments)
    assert str(context.params["out"]) == "demo"
    assert CliRunner().invoke(command, ["demo"]).exit_code == 2  # a bare folder is not an argument
