"""Tables that are written as Markdown and as HTML."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from ...core import html as report_html
from .process import Record

NOTHING = "-"


@dataclass
class Table:
    """Text in rows and columns; `notes` stand below. The first `names` columns are words, the others figures."""

    title: str
    header: list[str]
    rows: list[list[str]]
    names: int = 1
    notes: list[str] = field(default_factory=list)

    def markdown(self) -> str:
        """Heading, rows and notes in Markdown."""
        lines = markdown_table(self.header, self.rows)
        notes = [f"- {_one_line(note)}" for note in self.notes]
        return "\n\n".join("\n".join(part) for part in ([f"## {self.title}"], lines, notes) if part)

    def html(self) -> str:
        """Rows and notes in HTML, without the columns that are empty."""
        kept = filled_columns(self.header, self.rows)
        header, rows = [self.header[c] for c in kept], [[row[c] for c in kept] for row in self.rows]
        numbers = [place for place, column in enumerate(kept) if column >= self.names]
        text = f'<div style="overflow-x: auto">{report_html.table(header, rows, numbers)}</div>' if rows else ""
        return text + "".join(report_html.explain(note) for note in self.notes)


def page(title: str, lead: str, tables: Sequence[Table]) -> str:
    """All tables as one self-contained HTML page."""
    return report_html.page(title, lead, [report_html.Section(table.title, table.html()) for table in tables])


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table without the columns that are "-" in every row; none if there are no rows."""
    kept = filled_columns(header, rows)
    lines = [[header[column] for column in kept], ["---"] * len(kept)]
    lines += [[_one_line(row[column]) for column in kept] for row in rows]
    return ["| " + " | ".join(line) + " |" for line in lines] if rows else []


def filled_columns(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[int]:
    """Columns that say something in some row."""
    return [column for column in range(len(header)) if any(row[column] != NOTHING for row in rows)]


def number(value: float | None, factor: float, digits: int) -> str:
    """`value` times `factor` with `digits` decimals; "-" if there is none."""
    return NOTHING if value is None else f"{value * factor:.{digits}f}"


def spread(values: Sequence[float], factor: float, digits: int, with_range: bool) -> str:
    """Median, with [minimum, maximum] if asked and there are several; "-" if there is no value."""
    if not values:
        return NOTHING
    texts = [number(value, factor, digits) for value in (statistics.median(values), min(values), max(values))]
    return f"{texts[0]} [{texts[1]}, {texts[2]}]" if with_range and len(values) > 1 else texts[0]


def cell(records: Iterable[Record], key: str, factor: float, digits: int, with_range: bool) -> str:
    """`spread` over the records that have `key`."""
    return spread([record[key] for record in records if record.get(key) is not None], factor, digits, with_range)


def ratio(records: Sequence[Record], baseline: Sequence[Record], key: str) -> str:
    """Median of `key` over that of the baseline, from calls of the program that measured both; else "-"."""
    shared = {record["session"] for record in records} & {record["session"] for record in baseline}
    over, under = ([r[key] for r in part if r["session"] in shared] for part in (records, baseline))
    return f"{statistics.median(over) / statistics.median(under):.2f}" if shared else NOTHING


def _one_line(text: str) -> str:
    return " ".join(text.replace("|", "\\|").split())
