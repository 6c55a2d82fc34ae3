"""Documentation that cannot rot: links lead somewhere, commands parse, the reference is current."""

import re
import runpy
import shlex
from pathlib import Path

import click
import pytest
from uncle.cli.main import COMMANDS, main
from uncle.recon.core.config.map_config import known_keys
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.manifest import FrameRecord, Manifest, StageRecord

ROOT = Path(__file__).parents[1]
LINKS = runpy.run_path(str(ROOT / "docs" / "check_links.py"))
PAGES = [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").glob("*.md"))]


def fenced_commands() -> list[tuple[str, str]]:
    """(page, line) of every `uncle` command in a shell block."""
    found = []
    for page in PAGES:
        for block in re.findall(r"```sh\n(.*?)```", page.read_text(), flags=re.DOTALL):
            lines = block.replace("\\\n", " ").splitlines()
            found += [(page.name, line.strip()) for line in lines if line.strip().startswith("uncle ")]
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
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
    reachable = (ROOT / "README.md").read_text() + (ROOT / "docs" / "index.md").read_text()
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "index.md" or f"{page.name})" in reachable


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
        assert len(cells[0][-2].strip()) > 10, f"{key} has no description in recon/config.py"


def test_the_method_page_names_functions_that_exist():
    """`[file.py](../recon/file.py) `name`, `name`` in the table of docs/method.md."""
    text = (ROOT / "docs" / "method.md").read_text()
    named = re.findall(r"\(\.\./(recon/[\w/]+\.py)\),? ((?:`\w+`(?:, )?)+)", text)
    assert len(named) > 12
    for path, names in named:
        for name in re.findall(r"\w+", names):
            assert re.search(rf"(?:def|class) {name}\b", (ROOT / path).read_text()), f"{path} has no {name}"


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
