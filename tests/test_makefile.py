"""`make demo` gives `uncle demo` arguments that it takes."""

import re
from pathlib import Path

import click
from click.testing import CliRunner
from uncle.cli.demo import command
from uncle.cli.main import main

MAKEFILE = Path(__file__).parent.parent / "Makefile"


def test_the_demo_command_of_the_makefile_parses():
    recipe = re.search(r"BIN\)/uncle demo(.*)$", MAKEFILE.read_text(), re.MULTILINE)
    arguments = recipe.group(1).replace("$(DEMO)", "demo").split()
    parent = click.Context(main, info_name="uncle", **main.context_settings)
    context = command.make_context("demo", arguments, parent=parent)
    assert str(context.params["out"]) == "demo"
    assert CliRunner().invoke(main, ["demo", "demo"]).exit_code == 2  # a bare folder is not an argument
