"""Parts of the page of an inspection: the table of findings, and pictures that show whether the data fit."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import cv2
import numpy as np

from ..core.errors import DataError
from ..core.html import embed_picture, missing
from ..evaluation.inspection.correspondences import InspectedFrames
from ..evaluation.inspection.findings import Finding
from ..evaluation.inspection.registration import depth_outlines

_PICTURES = 3
_OUTLINE_RGB = (255, 0, 200)


def findings_table(findings: Sequence[Finding]) -> str:
    """HTML table: check, verdict, number, what was seen, what mends it."""
    rows = []
    for finding in findings:
        cells = (
            finding.check,
            str(finding.verdict),
            finding.number,
            finding.text,
            finding.remedy if finding.is_open else "",
        )
        rows.append("<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>")
    header = "".join(f"<th>{name}</th>" for name in ("check", "verdict", "number", "what was seen", "what mends it"))
    return f"<table><tr>{header}</tr>{''.join(rows)}</table>"


def inspection_pictures(frames: InspectedFrames, sensors: Sequence[str] = ()) -> str:
    """HTML figures: outlines in depth drawn over colour, of a few frames; they meet where both are registered."""
    sensor = (tuple(sensors) or frames.sensors)[0]
    figures = []
    for index in np.unique(np.linspace(0, len(frames) - 1, _PICTURES + 2).astype(int)[1:-1]):
        try:
            picture = _outlines_over_color(frames, int(index), sensor)
        except DataError as error:
            figures.append(missing(str(error)))
            continue
        figures.append(embed_picture(picture, f"frame {index}: outlines in the depth of {sensor}", photographic=True))
    return "".join(figures)


def _outlines_over_color(frames: InspectedFrames, index: int, sensor: str) -> bytes:
    color, depth = frames.color(index).numpy().copy(), frames.depth(index, sensor).numpy()
    nx2, _, ny2 = depth_outlines(depth)
    color[(nx2 + ny2) > 0] = _OUTLINE_RGB
    encoded: np.ndarray = cv2.imencode(".png", cv2.cvtColor(color, cv2.COLOR_RGB2BGR))[1]
    return encoded.tobytes()
