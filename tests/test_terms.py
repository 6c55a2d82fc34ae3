"""The code and the pages use the terms of the field: words of an earlier, private vocabulary must not return."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
HERE = Path(__file__).relative_to(ROOT)
SOURCES = ("recon", "cli", "datasets", "benchmarks", "examples", "tests", "docs", ".github")
SUFFIXES = {".py", ".md", ".toml", ".yml", ".yaml", ".cff"}
# The changelog's table of old and new names is the one place where old names have to stand.
CHANGELOG_TABLE = re.compile(r"^\| old \| new \|$.*?\n\n", re.MULTILINE | re.DOTALL)
BANNED = re.compile(r"witness(es)?|testimon(y|ies)|hears?|heard|worth|onlookers?|said|looks?")
IN_TESTS = re.compile(r"witness(es)?|testimon(y|ies)|hears?|heard|worth|onlookers?")  # the others are no terms there
CITED = "METHOD"  # a document that readers do not have
# Plain English, a function of Open3D, the placeholder METHOD:KEY=VALUE of an option, constants such as METHOD_NAMES.
ALLOWED = re.compile(
    r"\.look_at\(|\blooks?[ -](up|for|at|like)\b|\blooked up\b|METHOD:KEY|\"METHOD\"|METHODS?_|_METHODS?\b"
)
WORD = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


def files() -> list[Path]:
    """Source files and pages, relative to the root."""
    top = [path for path in ROOT.iterdir() if path.is_file() and path.suffix in SUFFIXES]
    inner = [path for name in SOURCES for path in (ROOT / name).rglob("*") if path.suffix in SUFFIXES]
    return sorted(path.relative_to(ROOT) for path in [*top, *inner] if path.relative_to(ROOT) != HERE)


def banned_words(text: str, banned: re.Pattern[str] = BANNED) -> list[str]:
    """`line: word` of each banned word; identifiers are split at underscores and capitals."""
    problems = []
    for number, line in enumerate(text.splitlines(), 1):
        words = WORD.findall(ALLOWED.sub(" ", line))
        problems += [f"{number}: {word}" for word in words if word == CITED or banned.fullmatch(word.lower())]
    return problems


def problems_of(path: Path) -> list[str]:
    text = (ROOT / path).read_text()
    if path.name == "CHANGELOG.md":
        text = CHANGELOG_TABLE.sub("", text)
    return banned_words(text, IN_TESTS if path.parts[0] == "tests" else BANNED)


def test_the_check_splits_identifiers_and_reads_prose():
    assert banned_words("x = ColorWitness(reading_worth)") == ["1: Witness", "1: worth"]
    assert banned_words("as METHOD says, colour is heard") == ["1: METHOD", "1: heard"]
    assert banned_words("lookup, look up, worthless, method, --set METHOD:KEY=VALUE, METHOD_OF") == []


@pytest.mark.parametrize("path", files(), ids=str)
def test_terms_of_the_field(path):
    assert problems_of(path) == [], f"{path}: CONTRIBUTING.md has the terms to use"
