"""Help is instant: nothing heavy is imported for it."""

import subprocess
import sys

import pytest
from click.testing import CliRunner
from uncle.cli.main import COMMANDS, main
from uncle.cli.pretrain import PRETRAIN

CHECK = """
import sys
sys.argv = ["uncle", *{arguments!r}]
from uncle.cli.main import main
main(standalone_mode=False)
heavy = {{"torch", "open3d", "cv2", "scipy", "matplotlib", "skimage"}} & set(sys.modules)
sys.exit(f"imported for help: {{sorted(heavy)}}" if heavy else 0)
"""


def imports_nothing_heavy(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "-c", CHECK.format(arguments=arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "Usage: uncle" in done.stdout


def test_help_imports_nothing_heavy():
    imports_nothing_heavy("--help")


@pytest.mark.parametrize("name", list(COMMANDS))
def test_help_of_commands_imports_nothing_heavy(name):
    imports_nothing_heavy(name, "--help")


@pytest.mark.parametrize("name", list(PRETRAIN))
def test_help_of_trainings_imports_nothing_heavy(name):
    imports_nothing_heavy("pretrain", name, "--help")


def test_every_command_is_listed():
    text = CliRunner().invoke(main, ["--help"]).output
    assert all(f"  {name} " in text for name in COMMANDS)


def test_unknown_commands_and_options_are_usage_errors():
    assert CliRunner().invoke(main, ["reconstruct"]).exit_code == 2
    assert CliRunner().invoke(main, ["--colour"]).exit_code == 2
