"""The page around the content of a report: one file, no scripts, nothing loaded from anywhere."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import cv2
import numpy as np

_STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; max-width: 1180px; padding: 28px 24px 60px; background: #fff; color: #20242a;
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 26px; margin: 0 0 4px; } h2 { font-size: 19px; margin: 40px 0 10px; padding-bottom: 5px;
  border-bottom: 1px solid #dfe3e8; } h3 { font-size: 15px; margin: 22px 0 6px; }
p.lead { color: #5a6472; margin: 0 0 16px; } p.missing { color: #77808c; background: #f6f7f9; padding: 9px 13px;
  border-left: 3px solid #c6ccd4; } p.explain { color: #5a6472; max-width: 80ch; margin: 4px 0 10px; }
nav a { margin-right: 14px; color: #1f5fa8; text-decoration: none; } nav a:hover { text-decoration: underline; }
figure { margin: 12px 0 20px; } img { max-width: 100%; height: auto; display: block; }
figcaption { color: #5a6472; font-size: 13px; }
table { border-collapse: collapse; margin: 6px 0 14px; font-size: 14px; } th, td { text-align: left; padding: 4px 14px
  4px 0; border-bottom: 1px solid #eceff2; vertical-align: top; overflow-wrap: anywhere; } th { color: #5a6472;
  font-weight: 600; } td.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.group td { padding-top: 14px; font-weight: 600; border-bottom: 1px solid #c6ccd4; }
pre { background: #f6f7f9; padding: 12px 14px; overflow-x: auto; font-size: 13px; line-height: 1.4; }
code { background: #f1f3f5; padding: 1px 4px; border-radius: 3px; }
"""
_JPEG_QUALITY = 82
MAX_WIDTH = 1400  # pixels of an embedded picture


@dataclass(frozen=True)
class Section:
    """`body` is HTML; `title` is text."""

    title: str
    body: str

    @property
    def anchor(self) -> str:
        """The title as a name that links can point to."""
        return "".join(letter if letter.isalnum() else "-" for letter in self.title.lower())


def page(title: str, lead: str, sections: Sequence[Section]) -> str:
    """The whole page; title and lead are text."""
    links = "".join(f'<a href="#{section.anchor}">{escape(section.title)}</a>' for section in sections)
    bodies = "\n".join(
        f'<section><h2 id="{section.anchor}">{escape(section.title)}</h2>\n{section.body}\n</section>'
        for section in sections
    )
    return (
        f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">\n<title>{escape(title)}</title>\n'
        f"<style>{_STYLE}</style>\n</head>\n<body>\n<h1>{escape(title)}</h1>\n"
        f'<p class="lead">{escape(lead)}</p>\n<nav>{links}</nav>\n{bodies}\n</body>\n</html>\n'
    )


def embed_picture(image: bytes, caption: str, *, photographic: bool) -> str:
    """A figure that carries its picture: scaled down to `MAX_WIDTH`, as JPG where it is photographic, else PNG."""
    pixels = cv2.imdecode(np.frombuffer(image, np.uint8), cv2.IMREAD_COLOR)
    if pixels is None:
        return missing(f"{caption}: the picture cannot be read")
    if pixels.shape[1] > MAX_WIDTH:
        height = round(pixels.shape[0] * MAX_WIDTH / pixels.shape[1])
        pixels = cv2.resize(pixels, (MAX_WIDTH, height), interpolation=cv2.INTER_AREA)
    kind, options = ("jpeg", [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]) if photographic else ("png", [])
    _, encoded = cv2.imencode(".jpg" if photographic else ".png", pixels, options)
    data = base64.b64encode(encoded.tobytes()).decode()
    text = escape(caption, quote=True)
    return (
        f'<figure><img src="data:image/{kind};base64,{data}" width="{pixels.shape[1]}" height="{pixels.shape[0]}" '
        f'alt="{text}"><figcaption>{text}</figcaption></figure>'
    )


def missing(text: str) -> str:
    """A line in the place of something that is not there; words between backticks are commands."""
    parts = escape(text).split("`")
    return (
        '<p class="missing">'
        + "".join(part if i % 2 == 0 else f"<code>{part}</code>" for i, part in enumerate(parts))
        + "</p>"
    )


def explain(text: str) -> str:
    """A sentence on how to read what follows."""
    return f'<p class="explain">{escape(text)}</p>'


def heading(text: str) -> str:
    """A heading inside a section."""
    return f"<h3>{escape(text)}</h3>"


def preformatted(text: str) -> str:
    """A text file as it is."""
    return f"<pre>{escape(text)}</pre>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], numbers: Sequence[int] = ()) -> str:
    """Rows of text; a row of one cell is a group heading; columns in `numbers` are set flush right."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    lines = []
    for row in rows:
        if len(row) == 1:
            lines.append(f'<tr class="group"><td colspan="{len(header)}">{escape(row[0])}</td></tr>')
            continue
        cells = "".join(
            f'<td class="number">{escape(cell)}</td>' if column in numbers else f"<td>{escape(cell)}</td>"
            for column, cell in enumerate(row)
        )
        lines.append(f"<tr>{cells}</tr>")
    return f"<table><thead><tr>{head}</tr></thead><tbody>\n" + "\n".join(lines) + "\n</tbody></table>"
