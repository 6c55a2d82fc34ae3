"""Writes docs/cli.md from the help of every command. `make docs` runs it; a test compares."""

from pathlib import Path

import click
from uncle.cli.main import main

PAGE = Path(__file__).with_name("cli.md")
WIDTH = 100


def render() -> str:
    """The page."""
    settings = {**main.context_settings, "terminal_width": WIDTH, "max_content_width": WIDTH}
    root = click.Context(main, info_name="uncle", **settings)
    sections = [("uncle", main.get_help(root))]
    for name in main.list_commands(root):
        command = main.get_command(root, name)
        context = click.Context(command, info_name=name, parent=root, **settings)
        sections.append((f"uncle {name}", command.get_help(context)))
    blocks = [f"## {title}\n\n```text\n{text.rstrip()}\n```" for title, text in sections]
    head = "# Command line\n\nGenerated from the help of the commands by `make docs`."
    return "\n\n".join([head, *blocks]) + "\n"


if __name__ == "__main__":
    PAGE.write_text(render())
