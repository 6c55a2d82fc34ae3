"""Streams that are closed or full, and a home directory that cannot be written."""

import os
import subprocess
import sys

import pytest
from uncle.cli.process import provide_matplotlib_folder
from uncle.recon.core.mesh import Mesh


@pytest.fixture
def shell(tmp_path):
    """Run a line of sh in which `uncle` is the program."""

    def run(line: str) -> subprocess.CompletedProcess[str]:
        script = f'uncle() {{ "{sys.executable}" -m uncle.cli.main "$@"; }}\n{line}'
        return subprocess.run(["bash", "-c", script], capture_output=True, text=True, cwd=tmp_path, check=False)

    return run


def test_a_reader_that_leaves_ends_the_program_quietly(shell):
    done = shell("uncle --help | head -1")
    assert done.stdout.startswith("Usage: uncle")
    assert done.stderr == ""


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_streams_get_nothing_and_files_are_whole(shell, tmp_path, box_room, closed):
    box_room.mesh().save(tmp_path / "box.ply")
    options = "--samples 100 --views 0 --error-mesh error.ply"
    done = shell(f"uncle eval box.ply box.ply {options} {closed}")
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert len(Mesh.load(tmp_path / "error.ply").faces) == 12


def test_errors_have_their_exit_code_without_streams(shell):
    assert shell("uncle eval none.ply none.ply >&- 2>&-").returncode == 1


@pytest.mark.parametrize("command", ["--help", "eval box.ply box.ply --samples 100 --views 0 --json"])
def test_a_full_disk_behind_stdout_is_one_line(shell, tmp_path, box_room, command):
    box_room.mesh().save(tmp_path / "box.ply")
    done = shell(f"uncle {command} > /dev/full")
    assert done.returncode == 1
    assert done.stderr == "Error: cannot write the output: No space left on device\n"


def test_matplotlib_gets_a_folder_where_there_is_no_home(monkeypatch):
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", "/dev/null")
    provide_matplotlib_folder()
    folder = os.environ["MPLCONFIGDIR"]
    assert os.access(folder, os.W_OK)
    monkeypatch.setenv("MPLCONFIGDIR", folder)  # undone at the end of the test


def test_the_folder_of_the_user_stays(monkeypatch, tmp_path):
    monkeypatch.delenv("MPLCONFIGDIR", raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    provide_matplotlib_folder()
    assert "MPLCONFIGDIR" not in os.environ
