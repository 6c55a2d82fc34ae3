"""Documentation that cannot rot: links lead somewhere, commands parse, references exist, the reference is current."""

import ast
import re
import runpy
import shlex
from functools import cache
from pathlib import Path

import click
import pytest
from uncle.cli.main import COMMANDS, main
from uncle.recon.core.config.map_config import known_keys
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.manifest import FrameRecord, Manifest, StageRecord

ROOT = Path(__file__).parents[1]
LINKS = runpy.run_path(str(ROOT / "docs" / "check_links.py"))
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "benchmarks").glob("*.md")])
TEMPLATES = sorted((ROOT / ".github").rglob("*.md"))
GENERATED = ("cli.md", "config.md")
MAX_LINES = {"README.md": 120, "docs/results.md": 250}
MAX_LINE_LENGTH = 120  # outside tables and code


def of_page(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@cache
def names_in(path: Path) -> frozenset[str]:
    """Functions, classes and module constants of a file; of a class also `Class.member`."""
    names = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            members = [child for child in node.body if isinstance(child, ast.FunctionDef)]
            fields = [child for child in node.body if isinstance(child, ast.AnnAssign)]
            names |= {f"{node.name}.{child.name}" for child in members}
            names |= {f"{node.name}.{child.target.id}" for child in fields if isinstance(child.target, ast.Name)}
        if isinstance(node, ast.Assign):
            names |= {target.id for target in node.targets if isinstance(target, ast.Name)}
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.add(node.target.id)
    return frozenset(names)


def fenced_commands() -> list[tuple[str, str]]:
    """(page, line) of every `uncle` command in a shell block."""
    commands = []
    for page in PAGES:
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(), flags=re.DOTALL):
            lines = block.replace("\\\n", " ").splitlines()
            commands += [(of_page(page), line.strip()) for line in lines if line.strip().startswith("uncle ")]
    return commands


@pytest.mark.parametrize("page", [*PAGES, *TEMPLATES], ids=of_page)
def test_links_lead_somewhere(page):
    assert list(LINKS["broken_links"](page)) == []


def test_links_to_absent_pages_and_headings_are_reported(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# A page, `code`\n[a](#a-page-code) [b](#b) [c](c.md) [d](https://nowhere.invalid/)\n`[e](e.md)`\n"
    )
    assert list(LINKS["broken_links"](page)) == [
        "#b: the page has no such heading", "c.md: there is no such file",
    ]  # fmt: skip


def test_every_page_can_be_reached():
    index = (ROOT / "docs" / "index.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "index.md" or f"]({page.name})" in index


@pytest.mark.parametrize("page", PAGES, ids=of_page)
def test_referenced_code_exists(page):
    """`path::name` in code spans: a function, class, member or constant of that file; `recon/...py` alone: the file."""
    for path, name in re.findall(r"`([\w/.]+\.py)(?:::([\w.]+))?`", page.read_text()):
        if "/" not in path or re.search(r"/[A-Z]+\.py$", path):  # a file of the room at hand; any command
            continue
        file = ROOT / path
        assert file.is_file(), f"{of_page(page)} refers to {path}"
        assert not name or name in names_in(file), f"{of_page(page)}: {path} has no {name}"


def test_the_method_and_the_architecture_refer_to_code():
    for name in ("method.md", "architecture.md"):
        assert len(re.findall(r"`[\w/.]+\.py::[\w.]+`", (ROOT / "docs" / name).read_text())) > 25


def test_the_architecture_has_the_rooms_and_what_they_may_import():
    """The table of docs/architecture.md equals that of tests/test_layers.py."""
    rooms = runpy.run_path(str(ROOT / "tests" / "test_layers.py"))["ROOMS"]
    rows = re.findall(r"^\| `(\w+)/` \|.*\| ([^|]*) \|$", (ROOT / "docs" / "architecture.md").read_text(), re.MULTILINE)
    assert {room: set(re.findall(r"\w+", allowed)) - {"nothing"} for room, allowed in rows} == rooms


@pytest.mark.parametrize("page", [page for page in PAGES if page.name not in GENERATED], ids=of_page)
def test_pages_are_short_and_narrow(page):
    text = page.read_text()
    assert len(text.splitlines()) <= MAX_LINES.get(of_page(page), 500)
    prose = re.sub(r"```.*?```", "", text, flags=re.DOTALL).splitlines()
    long = [line for line in prose if len(line) > MAX_LINE_LENGTH and not line.startswith("|")]
    assert long == []


@pytest.mark.parametrize("page", PAGES, ids=of_page)
def test_settings_and_scripts_in_commands_exist(page):
    """The keys of `--set KEY=VALUE`, also with a method in front, and the programs that are run by Python."""
    text = page.read_text()
    for key in re.findall(r"--set [\"']?(?:[\w-]+:)?([a-z][\w.]*)=", text):
        assert key in known_keys(), f"{of_page(page)} sets {key}"
    for script in re.findall(r"python ((?:benchmarks|examples|docs)/\w+\.py)", text):
        assert (ROOT / script).is_file(), f"{of_page(page)} runs {script}"


def test_there_are_commands_to_check():
    assert len(fenced_commands()) >= 8


@pytest.mark.parametrize(("page", "line"), fenced_commands())
def test_commands_in_the_docs_parse(page, line):
    words = shlex.split(line, comments=True)[1:]
    if words[0].startswith("-"):
        return
    assert words[0] in COMMANDS
    context = click.Context(main, info_name="uncle", **main.context_settings)
    command = main.get_command(context, words[0])
    command.make_context(words[0], words[1:], parent=context, resilient_parsing=False).close()


@pytest.mark.parametrize("script", ["generate_cli.py", "generate_config.py"])
def test_generated_pages_are_current(script):
    page = runpy.run_path(str(ROOT / "docs" / script))
    assert page["PAGE"].read_text() == page["render"](), "run `make docs`"
    assert f"python docs/{script}" in (ROOT / "Makefile").read_text()


def test_every_setting_is_described():
    rows = (ROOT / "docs" / "config.md").read_text().splitlines()
    for key in known_keys():
        cells = [row.split("|") for row in rows if row.startswith(f"| `{key}` |")]
        assert len(cells) == 1, f"{key} is not in docs/config.md"
        assert len(cells[0][-2].strip()) > 10, f"{key} has no description in recon/core/config/"


def test_every_file_of_a_run_is_described():
    text = (ROOT / "docs" / "run-directory.md").read_text()
    run = RunDirectory(Path("RUN"))
    paths = [getattr(run, name) for name, value in vars(RunDirectory).items() if isinstance(value, property)
             and name.endswith("_path")]  # fmt: skip
    assert len(paths) > 8
    for path in paths:
        assert f"`{path.relative_to('RUN')}" in text, f"{path} is not in docs/run-directory.md"


@pytest.mark.parametrize("model", [Manifest, FrameRecord, StageRecord])
def test_every_field_of_the_manifest_is_described(model):
    text = (ROOT / "docs" / "run-directory.md").read_text()
    for name in model.model_fields:
        assert f"`{name}`" in text, f"{model.__name__}.{name} is not in docs/run-directory.md"
