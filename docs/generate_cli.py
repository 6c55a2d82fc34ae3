"""Writes docs/cli.md from the help of every command; with `--check` it only compares. `make docs` runs it."""

import sys
from pathlib import Path

import click
from uncle.cli.main import main

PAGE = Path(__file__).with_name("cli.md")
WIDTH = 100
SETTINGS = {**main.context_settings, "terminal_width": WIDTH, "max_content_width": WIDTH}


def helps(command: click.Command, context: click.Context) -> list[tuple[str, str]]:
    """(name, help) of a command and, where it is a group, of all its commands."""
    found = [(context.command_path, command.get_help(context))]
    for name in command.list_commands(context) if isinstance(command, click.Group) else []:
        inner = command.get_command(context, name)
        found += helps(inner, click.Context(inner, info_name=name, parent=context, **SETTINGS))
    return found


def render() -> str:
    """The page."""
    sections = helps(main, click.Context(main, info_name="uncle", **SETTINGS))
    blocks = [f"## {title}\n\n```text\n{text.rstrip()}\n```" for title, text in sections]
    head = "# Command line\n\nGenerated from the help of the commands by `make docs`."
    return "\n\n".join([head, *blocks]) + "\n"


if __name__ == "__main__":
    if "--check" in sys.argv[1:]:
        sys.exit(0 if PAGE.read_text() == render() else "docs/cli.md is out of date; run `make docs`")
    PAGE.write_text(render())
