"""Missing libraries are named together with the command that installs them."""

import ctypes
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from uncle.cli import main as cli
from uncle.recon.core import system_check as system

SCRIPT = Path(__file__).parents[3] / "recon" / "core" / "system_check.py"


@pytest.fixture
def without(monkeypatch):
    """Pretend that some libraries are missing."""

    load = ctypes.CDLL

    def hide(*hidden: str) -> None:
        def pretend(library, *options):
            if library in hidden:
                raise OSError(library)
            return None if library in {**system.REQUIRED, **system.PICTURES} else load(library, *options)

        monkeypatch.setattr(ctypes, "CDLL", pretend)

    return hide


def test_a_complete_machine_has_no_complaint(without):
    without()
    assert system.complaint() is None


def test_the_complaint_holds_libraries_and_command(without):
    without("libGL.so.1", "libusb-1.0.so.0")
    text = system.complaint()
    assert "libGL.so.1, libusb-1.0.so.0" in text
    assert "apt-get install -y libgl1 libusb-1.0-0" in text
    assert "libegl1" not in text


def test_a_library_is_missing_if_it_does_not_load(monkeypatch):
    monkeypatch.setattr(system, "REQUIRED", {"libnosuchthing.so.9": "nosuchthing", "libc.so.6": "libc6"})
    assert system.missing_packages() == {"libnosuchthing.so.9": "nosuchthing"}


def test_the_check_runs_before_anything_is_installed():
    """Isolated and without site packages, as on a fresh machine."""
    done = subprocess.run([sys.executable, "-I", "-S", str(SCRIPT)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "") if system.complaint() is None else done.returncode == 1


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ImportError("libGL.so.1: cannot open shared object file: No such file"), ["libGL.so.1", "apt-get", "libgl1"]),
        (OSError("libEGL.so.1: cannot open shared object file: No such file"), ["libEGL.so.1", "apt-get", "libegl1"]),
        (ModuleNotFoundError("No module named 'open3d'", name="open3d"), ["open3d", "pip install"]),
    ],
)
def test_failed_imports_become_one_line(without, monkeypatch, error, words):
    without("libGL.so.1", "libEGL.so.1")

    @click.command()
    def broken():
        raise error

    monkeypatch.setattr(cli.LazyGroup, "get_command", lambda self, ctx, name: broken)
    result = CliRunner().invoke(cli.main, ["mesh"])
    assert result.exit_code == 1
    assert result.stderr.startswith("Error: ")
    assert len(result.stderr.splitlines()) == 1
    assert all(word in result.stderr for word in words)


@pytest.mark.parametrize(
    "error", [ImportError("cannot import name 'x'"), ModuleNotFoundError("", name="uncle.recon.x")]
)
def test_defects_of_the_program_stay_defects(error):
    assert system.dependency_error(error) is None
