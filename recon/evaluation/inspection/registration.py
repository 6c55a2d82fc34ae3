"""By how many pixels colour lies beside depth: where the edges of depth images meet edges of the colour images.

An object's outline shows in both. The outlines in depth are moved over the colour images; the place where the
gradients of colour across them are strongest is where colour belongs. A colour image of another calibration is larger
or smaller than depth, and fits best when the outlines are scaled.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import cv2
import numpy as np

from ...core.errors import DataError
from .correspondences import InspectedFrames

FRAMES = 24
REACH_PX = 24  # largest displacement that is looked for
JUMP = 0.08  # relative jump of inverse depth at an outline
SCALES = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.25)
MIN_SCALE_RATIO = 1.15  # of the heights, for which a scale other than 1 is believed
MIN_OUTLINE = 800  # pixels of outline below which nothing can be concluded


@dataclass(frozen=True)
class Registration:
    """Where colour lies beside depth.

    `x`, `y` pixels to the right and down; `scale` of colour relative to depth; `height` of the best agreement above
    the mean of all displacements, in standard deviations; `gain` of it over the agreement as stated, the same unit;
    `outline` pixels that took part.
    """

    x: float
    y: float
    scale: float
    height: float
    gain: float
    outline: int


class _Agreement:
    """Agreement of colour with the outlines of one sensor, for every scale and displacement, summed over images."""

    def __init__(self, scales: Sequence[float]) -> None:
        side = 2 * REACH_PX + 1
        self.total = {scale: np.zeros((side, side)) for scale in scales}
        self.outline = 0

    def add(self, depth: np.ndarray, spectra: Sequence[np.ndarray]) -> None:
        """Add a depth image (H, W), metres, and the spectra of the gradients of its colour."""
        edges = depth_outlines(depth)
        self.outline += int((edges[0] != 0).sum() + (edges[1] != 0).sum())
        for scale in self.total:
            self.total[scale] += _correlation(_scaled(edges, scale), spectra, depth.shape)


def measure_registration(
    frames: InspectedFrames, sensors: Sequence[str], indices: Sequence[int], scales: Sequence[float] = SCALES
) -> dict[str, Registration]:
    """Displacement of colour against the outlines in the depth of each sensor that shows enough of them.

    `scales` of colour relative to depth are tried; 1 must be among them.
    """
    agreements = {sensor: _Agreement(scales) for sensor in sensors}
    for index in indices:
        try:
            spectra = [np.fft.rfft2(part) for part in _color_gradients(frames.color(index).numpy())]
        except DataError:
            continue
        for sensor, agreement in agreements.items():
            with suppress(DataError):
                agreement.add(frames.depth(index, sensor).numpy(), spectra)
    return {sensor: _peak(one.total, one.outline) for sensor, one in agreements.items() if one.outline >= MIN_OUTLINE}


def depth_outlines(depth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Squares and product of the unit normal of the outline (H, W) each, at pixels on the near side of a jump."""
    inverse_depth = np.where(depth > 0, 1.0 / np.maximum(depth, 1e-6), 0.0).astype(np.float32)
    known = (depth > 0).astype(np.float32)
    gx, gy = np.zeros_like(inverse_depth), np.zeros_like(inverse_depth)
    gx[:, 1:-1] = (inverse_depth[:, 2:] - inverse_depth[:, :-2]) * known[:, 2:] * known[:, :-2]
    gy[1:-1] = (inverse_depth[2:] - inverse_depth[:-2]) * known[2:] * known[:-2]
    size = np.hypot(gx, gy)
    near = cv2.dilate(inverse_depth, np.ones((3, 3))) <= inverse_depth * (1 + JUMP)
    outline = (size > JUMP * np.maximum(inverse_depth, 1e-6)) & near & (known > 0)
    safe = np.where(outline, size, 1.0)
    nx, ny = np.where(outline, gx / safe, 0.0), np.where(outline, gy / safe, 0.0)
    return nx * nx, nx * ny, ny * ny


def _color_gradients(color: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Structure tensor (H, W) each of grey values, by the local contrast: faint and strong edges count alike."""
    gray = cv2.GaussianBlur(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32), (0, 0), 1.0)
    gx, gy = cv2.Sobel(gray, cv2.CV_32F, 1, 0), cv2.Sobel(gray, cv2.CV_32F, 0, 1)
    energy = gx * gx + gy * gy
    norm = energy + cv2.GaussianBlur(energy, (0, 0), 15) + 25.0
    return gx * gx / norm, gx * gy / norm, gy * gy / norm


def _scaled(edges: tuple[np.ndarray, ...], scale: float) -> list[np.ndarray]:
    if scale == 1.0:
        return list(edges)
    height, width = edges[0].shape
    rows, columns = np.nonzero((edges[0] != 0) | (edges[2] != 0))
    new_rows = np.rint((rows - height / 2) * scale + height / 2).astype(int)
    new_columns = np.rint((columns - width / 2) * scale + width / 2).astype(int)
    inside = (new_rows >= 0) & (new_rows < height) & (new_columns >= 0) & (new_columns < width)
    moved = []
    for edge in edges:
        target = np.zeros_like(edge)
        target[new_rows[inside], new_columns[inside]] = edge[rows[inside], columns[inside]]
        moved.append(target)
    return moved


def _correlation(edges: Sequence[np.ndarray], spectra: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """(2 R + 1, 2 R + 1): colour gradients across the outlines for every displacement, per pixel of outline."""
    count = max(float(edges[0].sum() + edges[2].sum()), 1.0)
    weights = (1.0, 2.0, 1.0)
    product = sum(w * np.conj(np.fft.rfft2(e)) * s for w, e, s in zip(weights, edges, spectra, strict=True))
    full = np.fft.irfft2(product, s=shape)
    reach = np.arange(-REACH_PX, REACH_PX + 1)
    window: np.ndarray = full[np.ix_(reach, reach)]
    return window / count


def _peak(total: dict[float, np.ndarray], outline: int) -> Registration:
    flat = {scale: _without_background(score) for scale, score in total.items()}
    deviation = max(float(np.std(flat[1.0])), 1e-9)
    best_scale = max(flat, key=lambda scale: flat[scale].max())
    ratio = float(flat[best_scale].max() / max(flat[1.0].max(), 1e-9))
    if ratio < MIN_SCALE_RATIO:
        best_scale = 1.0
    score = flat[best_scale]
    row, column = np.unravel_index(int(score.argmax()), score.shape)
    centre = flat[1.0][REACH_PX, REACH_PX]
    return Registration(
        x=float(column - REACH_PX), y=float(row - REACH_PX), scale=best_scale,
        height=float(score.max() / deviation), gain=float((score.max() - centre) / deviation), outline=outline,
    )  # fmt: skip


def _without_background(score: np.ndarray) -> np.ndarray:
    smooth = cv2.GaussianBlur(score, (0, 0), 10)
    result: np.ndarray = score - smooth
    return result
