"""What an installed package holds: every module, the weights, the marker of types, one version."""

import tomllib
from importlib.metadata import version
from pathlib import Path

import pytest
import uncle.recon
from click.testing import CliRunner
from setuptools import Distribution
from uncle.cli.main import main

ROOT = Path(__file__).parents[1]
TOP = ("recon", "cli", "datasets")


@pytest.fixture(scope="module")
def installed() -> set[str]:
    """Paths in the wheel, relative to the package `uncle`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        distribution = Distribution({"script_name": "setup.py"})  # needed, though there is no such file
        distribution.parse_config_files()
        build = distribution.get_command_obj("build_py")
        build.ensure_finalized()
        outputs = build.get_outputs(include_bytecode=False)
        return {str(Path(path).relative_to(Path(build.build_lib) / "uncle")) for path in outputs}


def test_every_module_is_in_the_wheel(installed):
    modules = {str(path.relative_to(ROOT)) for top in TOP for path in (ROOT / top).rglob("*.py")}
    assert {path for path in installed if path.endswith(".py")} == modules


def test_all_weights_are_in_the_wheel(installed):
    weights = {str(path.relative_to(ROOT)) for top in TOP for path in (ROOT / top).rglob("*.pt")}
    assert len(weights) >= 3
    assert weights <= installed


@pytest.mark.parametrize("top", TOP)
def test_installed_packages_are_marked_as_typed(installed, top):
    assert f"{top}/py.typed" in installed


def test_there_is_one_version():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert uncle.recon.__version__ == version("uncle") == project["version"]
    assert CliRunner().invoke(main, ["--version"]).output == f"uncle, version {project['version']}\n"


def test_other_names_of_the_library_are_unknown():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = uncle.recon.nothing
