"""What the Makefile offers: targets that exist, and commands with arguments that they take."""

import re
import subprocess
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from uncle.cli.demo import command
from uncle.cli.main import main

ROOT = Path(__file__).parent.parent
MAKEFILE = ROOT / "Makefile"
TARGETS = re.search(r"^\.PHONY: (.*)$", MAKEFILE.read_text(), re.MULTILINE)[1].split()


def planned(target: str) -> str:
    """The recipe lines that `make` would run for a target in a virtual environment that is set up."""
    command = ["make", "--dry-run", "--old-file=.venv/.installed", target]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout


def test_the_demo_command_of_the_makefile_parses():
    recipe = re.search(r"BIN\)/uncle demo(.*)$", MAKEFILE.read_text(), re.MULTILINE)
    arguments = recipe.group(1).replace("$(DEMO)", "demo").split()
    parent = click.Context(main, info_name="uncle", **main.context_settings)
    context = command.make_context("demo", arguments, parent=parent)
    assert str(context.params["out"]) == "demo"
    assert CliRunner().invoke(main, ["demo", "demo"]).exit_code == 2  # a bare folder is not an argument


@pytest.mark.parametrize("target", TARGETS)
def test_every_target_has_a_recipe(target):
    assert planned(target).strip()


def test_make_check_runs_every_check():
    plan = planned("check")
    for tool in ("ruff check", "ruff format --check", "mypy", "codespell", "check_links", "--check", "vulture"):
        assert tool in plan


def test_pages_are_generated_and_compared_by_the_same_scripts():
    written, compared = planned("docs"), planned("generated")
    for script in sorted((ROOT / "docs").glob("generate_*.py")):
        assert f"docs/{script.name}" in written
        assert f"docs/{script.name} --check" in compared


def test_the_continuous_integration_runs_checks_and_tests():
    script = (ROOT / ".ci" / "run").read_text()
    assert re.search(r"^make .*check \|\| code=\$\?$", script, re.MULTILINE)
    assert re.search(r"^make test .*\|\| code=\$\?$", script, re.MULTILINE)
    assert script.rstrip().endswith('exit "$code"')


def test_every_pinned_tool_is_a_requirement_or_of_one():
    pins = (ROOT / "constraints.txt").read_text().split()
    assert all(re.fullmatch(r"[\w.-]+==[\w.]+", pin) for pin in pins)
    assert pins == sorted(pins, key=lambda pin: pin.partition("==")[0].replace("_", "-"))
