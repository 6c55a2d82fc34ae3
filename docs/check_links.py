"""Checks the relative links of the pages, with their anchors: python docs/check_links.py [PAGE ...].

Without pages: those at the top and in docs/, examples/, benchmarks/ and .github/. Addresses on the web are not asked
for, so that the check needs no network. The exit code is 1 if a link leads nowhere.
"""

import re
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
FENCE = re.compile(r"^(```|~~~).*?^\1", re.MULTILINE | re.DOTALL)
INLINE_CODE = re.compile(r"`[^`\n]*`")
LINK = re.compile(r"\[[^\]]*\]\(\s*<?([^)\s>]+)>?[^)]*\)|^\[[^\]]+\]:\s*(\S+)", re.MULTILINE)
HEADING = re.compile(r"^#{1,6}\s+(.*?)\s*#*$", re.MULTILINE)
HTML_ANCHOR = re.compile(r"<[^>]+\b(?:id|name)=\"([^\"]+)\"")


def pages() -> list[Path]:
    """Every page of the documentation."""
    return [
        *sorted(ROOT.glob("*.md")),
        *sorted((ROOT / "docs").rglob("*.md")),
        *sorted((ROOT / "examples").rglob("*.md")),
        *sorted((ROOT / "benchmarks").rglob("*.md")),
        *sorted((ROOT / ".github").rglob("*.md")),
    ]


def slug(heading: str) -> str:
    """The anchor of a heading, as code hosts make it: lower case, without punctuation, hyphens for blanks."""
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower()
    return re.sub(r"[^\w\- ]", "", text).replace(" ", "-")


@cache
def anchors(page: Path) -> frozenset[str]:
    """All anchors of a page; a heading that is repeated has a number behind."""
    text = FENCE.sub("", page.read_text())
    count: Counter[str] = Counter()
    names = set(HTML_ANCHOR.findall(text))
    for heading in HEADING.findall(text):
        name = slug(heading)
        names.add(f"{name}-{count[name]}" if count[name] else name)
        count[name] += 1
    return frozenset(names)


def broken_links(page: Path) -> Iterator[str]:
    """`target: reason` of every relative link of the page that leads nowhere."""
    text = INLINE_CODE.sub("", FENCE.sub("", page.read_text()))
    for match in LINK.finditer(text):
        target = match[1] or match[2]
        if re.match(r"[a-z][a-z+.-]*:", target):
            continue
        path, _, anchor = target.partition("#")
        file = (page.parent / path).resolve() if path else page
        if not file.exists():
            yield f"{target}: there is no such file"
        elif anchor and file.suffix == ".md" and anchor not in anchors(file):
            yield f"{target}: the page has no such heading"


def main(arguments: list[str]) -> int:
    """Print what is broken; the exit code."""
    lines = [
        f"{page.relative_to(ROOT) if page.is_relative_to(ROOT) else page}: {problem}"
        for page in [Path(argument).resolve() for argument in arguments] or pages()
        for problem in broken_links(page)
    ]
    for line in lines:
        print(line)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
