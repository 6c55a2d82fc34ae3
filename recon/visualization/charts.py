"""Pictures with colour bars, and line charts, as PNG bytes. Matplotlib is imported only when one is drawn."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_DPI = 110


@dataclass(frozen=True)
class ColorScale:
    """Values `low`..`high` (SI) as colours of a Matplotlib colour map; `factor` converts to the unit of `label`."""

    label: str
    low: float
    high: float
    colormap: str = "turbo"
    factor: float = 1.0

    def paint(self, values: np.ndarray) -> np.ndarray:
        """(...) values -> (..., 3) uint8 RGB; values that are not finite become grey."""
        import matplotlib

        ratio = np.clip((np.nan_to_num(values) - self.low) / (self.high - self.low), 0, 1)
        colors = (matplotlib.colormaps[self.colormap](ratio)[..., :3] * 255 + 0.5).astype(np.uint8)
        colors[~np.isfinite(values)] = 160
        return colors

    def draw_bar(self, figure: Figure, **layout: Any) -> None:
        """A colour bar; `layout` holds placement arguments of `Figure.colorbar`. Its arrow means all larger values."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import Normalize

        colors = ScalarMappable(Normalize(self.low * self.factor, self.high * self.factor), self.colormap)
        figure.colorbar(colors, label=self.label, extend="max", **layout)


@dataclass(frozen=True)
class Line:
    """One curve of a chart: x (N,), y (N,); the line has a gap where y is not finite."""

    name: str
    x: np.ndarray
    y: np.ndarray
    style: str = "-"
    color: str | None = None


def new_figure(width: float, height: float) -> Figure:
    """A figure of `width` x `height` inches without the global state of pyplot."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def encode_figure(figure: Figure) -> bytes:
    """The figure as PNG."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI)
    return stream.getvalue()


def show_picture(axes: Axes, picture: np.ndarray, title: str = "") -> None:
    """Show a picture (H, W) or (H, W, 3) without ticks."""
    axes.imshow(picture, interpolation="antialiased")
    axes.set_title(plain(title), fontsize=10)
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color("#d0d0d0")


def picture_sheet(title: str, titles: Sequence[str], pictures: Sequence[np.ndarray], scale: ColorScale | None) -> bytes:
    """Pictures (H, W, 3) in two columns under a title, with a colour bar if `scale` is given; PNG."""
    columns = min(2, len(pictures))
    rows = -(-len(pictures) // columns)
    height, width = pictures[0].shape[:2]
    cell = 5.6
    figure = new_figure(cell * columns + (1.0 if scale else 0.0), (cell * height / width + 0.3) * rows + 0.4)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(pictures) :]:
        axes.axis("off")
    for axes, name, picture in zip(grid.flat, titles, pictures, strict=False):
        show_picture(axes, picture, name)
    if scale is not None:
        scale.draw_bar(figure, ax=list(grid.flat), shrink=0.8, pad=0.02)
    figure.suptitle(plain(title), fontsize=13)
    return encode_figure(figure)


def draw_lines(axes: Axes, lines: Sequence[Line], x_label: str, y_label: str, title: str = "") -> None:
    """Draw curves with grid, labels and, if there are several, a legend."""
    for line in lines:
        axes.plot(line.x, line.y, line.style, label=plain(line.name), color=line.color, linewidth=1.6, markersize=3.5)
    axes.set_xlabel(plain(x_label))
    axes.set_ylabel(plain(y_label))
    axes.set_title(plain(title), fontsize=11)
    axes.grid(True, color="#e6e6e6")
    axes.spines[["top", "right"]].set_visible(False)
    if len(lines) > 1:
        axes.legend(frameon=False, fontsize=9)


def plain(text: str) -> str:
    """Escape text for Matplotlib, where a dollar sign starts a formula and a leading underscore hides a label."""
    return text.replace("$", r"\$").removeprefix("_")
