"""`uncle snapshot`, `uncle report` and `uncle demo` as a user meets them."""

import json
import sys

import click
import pytest
from click.testing import CliRunner, Result
from uncle.cli import demo
from uncle.cli.main import main


def uncle(*arguments: object) -> Result:
    return CliRunner().invoke(main, list(map(str, arguments)))


@pytest.fixture
def mesh(tmp_path, box_room):
    path = tmp_path / "room.ply"
    box_room.mesh().save(path)
    return path


def test_snapshot_of_a_mesh_prints_its_sheets(mesh, tmp_path):
    out = tmp_path / "pictures"
    result = uncle("snapshot", mesh, "--gt", mesh, "--out", out, "--size", "64x48", "--renderer", "raycast")
    assert result.exit_code == 0, result.output
    assert result.stdout.split() == [str(out / "shaded.png"), str(out / "error.png")]
    assert "ray caster" in result.stderr


def test_snapshot_of_a_run_by_folder_or_option(make_box_run, box_room):
    run = make_box_run()
    box_room.mesh().save(run.mesh_path)
    for arguments in ([run.root], ["--run", run.root]):
        result = uncle("snapshot", *arguments, "--mode", "shaded", "--size", "64x48", "--renderer", "raycast")
        assert result.exit_code == 0, result.output
        assert result.stdout.split() == [str(run.snapshots_path / "shaded.png")]


@pytest.mark.parametrize("arguments", [[], ["--mode", "shaded"]])
def test_run_without_mesh(make_box_run, arguments):
    result = uncle("snapshot", make_box_run().root, *arguments)
    assert result.exit_code == 1
    assert "uncle mesh" in result.stderr
    assert "Traceback" not in result.output


def test_snapshot_mistakes_are_one_line(tmp_path, mesh):
    broken = tmp_path / "broken.ply"
    broken.write_bytes(b"ply\n")
    for arguments, code in (
        ([tmp_path / "none.ply"], 1), ([broken], 1), ([tmp_path], 1), ([mesh, "--mode", "error"], 1),
        ([mesh, "--size", "big"], 2), ([mesh, "--size", "0x5"], 2), ([mesh, "--mode", "wire"], 2),
    ):  # fmt: skip
        result = uncle("snapshot", *arguments, "--renderer", "raycast")
        assert result.exit_code == code, (arguments, result.output)
        assert result.stderr.strip().splitlines()[-1].startswith("Error: ")


def test_report_prints_its_path(make_box_run):
    run = make_box_run()
    result = uncle("report", "--run", run.root, "--renderer", "raycast")
    assert result.exit_code == 0, result.output
    assert result.stdout.strip() == str(run.report_path)
    assert run.report_path.is_file()


def test_report_of_no_run(tmp_path):
    result = uncle("report", "--run", tmp_path)
    assert result.exit_code == 1
    assert "uncle preprocess" in result.stderr


@pytest.fixture
def recorded(monkeypatch):
    """The stages that the demo runs, in place of running them."""
    calls = []

    def get_command(ctx, name):
        @click.command(name, context_settings={"ignore_unknown_options": True})
        @click.argument("arguments", nargs=-1, type=click.UNPROCESSED)
        def command(arguments):
            calls.append([name, *arguments])

        return command

    monkeypatch.setattr(demo, "main", type("Group", (), {"get_command": staticmethod(get_command)}))
    return calls


def test_demo_announces_and_runs_the_chain(recorded, tmp_path):
    result = uncle("demo", "--out", tmp_path / "d", "--frames", "5", "--size", "64")
    assert result.exit_code == 0, result.output
    assert [call[0] for call in recorded] == ["synth", "preprocess", "map", "mesh", "eval", "report"]
    assert all(f"[{number}/6]" in result.stderr for number in range(1, 7))
    assert recorded[2][recorded[2].index("--sensors") + 1 :][:2] == ["sl", "sgm"]
    assert all("--overwrite" in call for call in recorded[:4])


def test_second_demo_keeps_the_room_unless_it_is_another(recorded, tmp_path):
    facts = {"parameters": {"frames": 5, "size_px": 64, "seed": 0, "mesh": None}}
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "synth.json").write_text(json.dumps(facts))
    arguments = ["demo", "--out", tmp_path, "--frames", "5", "--size", "64"]
    assert uncle(*arguments).exit_code == 0
    assert [call[0] for call in recorded] == ["preprocess", "map", "mesh", "eval", "report"]
    assert not any("--overwrite" in call for call in recorded)
    recorded.clear()
    assert uncle(*arguments, "--seed", "1").exit_code == 0
    assert recorded[0][0] == "synth"


def test_commands_do_not_import_heavy_libraries_at_the_top():
    import subprocess

    code = (
        "import sys, uncle.cli.snapshot, uncle.cli.report, uncle.cli.demo;"
        "sys.exit(any(name in sys.modules for name in ('torch', 'open3d', 'matplotlib', 'cv2')))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
