"""The charts of a report: noise of the sensors, curves of the map stage, and calibration of the uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..evaluation.noise_curves import NoiseCurve, SensorNoise
from .charts import Line, draw_lines, encode_figure, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CM = 100.0
_LEARNED, _TRUE, _DEPTH_ONLY, _IDEAL = "#1f77b4", "#d62728", "#2ca02c", "#888888"


def noise_chart(sensor: str, noise: SensorNoise) -> bytes:
    """Mean beta and mean true error against depth and incidence; PNG."""
    figure = new_figure(11.0, 3.4)
    left, right = figure.subplots(1, 2, sharey=True)
    draw_lines(left, _noise_lines(noise.by_depth), "depth [m]", "[cm]", f"{sensor}: noise against depth")
    if np.isfinite(noise.by_incidence.beta).any():
        draw_lines(right, _noise_lines(noise.by_incidence), "incidence [°]", "", f"{sensor}: noise against incidence")
    else:
        right.axis("off")
    left.set_ylim(bottom=0)
    return encode_figure(figure)


def _noise_lines(curve: NoiseCurve) -> list[Line]:
    lines = [Line("learned: mean beta", curve.x, curve.beta * _CM, "o-", _LEARNED)]
    if curve.error is not None:
        lines.append(Line("true: mean absolute error", curve.x, curve.error * _CM, "o--", _TRUE))
    return lines


def curves_chart(curves: Mapping[str, Any]) -> bytes | None:
    """One small chart per curve of `curves.json`; other entries are left out; None if none is left; PNG."""
    usable = {name: curve for name, curve in curves.items() if _is_curve(curve)}
    if not usable:
        return None
    columns = min(2, len(usable))
    rows = -(-len(usable) // columns)
    figure = new_figure(5.5 * columns, 2.9 * rows)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(usable) :]:
        axes.axis("off")
    for axes, (name, curve) in zip(grid.flat, usable.items(), strict=False):
        line = Line(name, _numbers(curve["x"]), _numbers(curve["y"]), "-", _LEARNED)
        draw_lines(axes, [line], str(curve.get("x_label", "")), str(curve.get("y_label", "")), name.replace("_", " "))
    return encode_figure(figure)


def uncertainty_calibration_chart(sensor: str, curves: Mapping[str, Any]) -> bytes | None:
    """Coverage, predicted against true error, and sparsification of one sensor, as `uncle eval` saved them; PNG."""
    names = ("nominal", "empirical", "bin_beta_m", "bin_error_m", "removed", "error_by_beta", "error_oracle")
    if not all(_is_numeric(curves.get(name)) for name in names):
        return None
    values = {name: _numbers(curves[name]) for name in names}
    figure = new_figure(11.0, 3.3)
    coverage, error, sparse = figure.subplots(1, 3)
    percent, lengths = ("predicted coverage [%]", "empirical coverage [%]"), ("beta [cm]", "mean true error [cm]")
    _against_diagonal(coverage, values["nominal"] * 100, values["empirical"] * 100, *percent, f"{sensor}: intervals")
    _against_diagonal(error, values["bin_beta_m"] * _CM, values["bin_error_m"] * _CM, *lengths, f"{sensor}: scale")
    removed = values["removed"] * 100
    lines = [
        Line("largest beta removed first", removed, values["error_by_beta"], "-", _LEARNED),
        Line("largest error removed first (oracle)", removed, values["error_oracle"], "--", _IDEAL),
    ]
    if _is_numeric(curves.get("error_by_depth")):
        by_depth = _numbers(curves["error_by_depth"])
        lines.insert(1, Line("best beta of depth alone", removed, by_depth, ":", _DEPTH_ONLY))
    draw_lines(
        sparse, lines, "measurements removed [%]", "mean error of the rest, relative", f"{sensor}: sparsification"
    )
    return encode_figure(figure)


def reliability_chart(curves: Mapping[str, Any]) -> bytes | None:
    """Empirical against predicted coverage of central intervals, one line for each name; None if there are none; PNG.

    `curves`: name -> `nominal` and `empirical`, as in `metrics.json` (`reliability_curves`).
    """
    lines = [
        Line(name, _numbers(curve["nominal"]) * 100, _numbers(curve["empirical"]) * 100, "o-")
        for name, curve in curves.items()
        if isinstance(curve, dict) and _is_curve({"x": curve.get("nominal"), "y": curve.get("empirical")})
    ]
    if not lines:
        return None
    figure = new_figure(5.2, 4.6)
    axes = figure.subplots()
    whole = np.array([0.0, 100.0])
    lines.append(Line("ideal", whole, whole, "--", _IDEAL))
    draw_lines(axes, lines, "predicted coverage [%]", "empirical coverage [%]", "below the diagonal: overconfident")
    axes.set_aspect("equal")
    return encode_figure(figure)


def reliability_curves(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """The curves of every sensor and of the mesh's vertices in a `metrics.json`, for `reliability_chart`."""
    sensors, surface = metrics.get("uncertainty"), metrics.get("surface")
    vertex_sigma = surface.get("vertex_sigma") if isinstance(surface, dict) else None
    scored = {**(sensors if isinstance(sensors, dict) else {}), "vertices of the mesh": vertex_sigma}
    return {
        name: scores["curves"] for name, scores in scored.items() if isinstance(scores, dict) and "curves" in scores
    }


def vertex_sigma_chart(curves: Mapping[str, Any]) -> bytes | None:
    """Coverage, and sigma against true distance, of the vertices, as `uncle eval` saved them; PNG."""
    names = ("nominal", "empirical", "bin_sigma_m", "bin_distance_rms_m")
    if not all(_is_numeric(curves.get(name)) for name in names):
        return None
    nominal, empirical, sigma, distance = (_numbers(curves[name]) for name in names)
    figure = new_figure(8.0, 3.4)
    coverage, size = figure.subplots(1, 2)
    percent = ("predicted coverage [%]", "empirical coverage [%]")
    lengths = ("sigma [cm]", "RMS distance to the truth [cm]")
    _against_diagonal(coverage, nominal * 100, empirical * 100, *percent, "vertices: intervals")
    _against_diagonal(size, sigma * _CM, distance * _CM, *lengths, "vertices: scale")
    return encode_figure(figure)


def _against_diagonal(axes: Axes, x: np.ndarray, y: np.ndarray, x_label: str, y_label: str, title: str) -> None:
    end = float(np.nanmax(np.concatenate([x, y, [0.0]])))
    ideal = np.array([0.0, end])
    lines = [Line("learned", x, y, "o-", _LEARNED), Line("ideal", ideal, ideal, "--", _IDEAL)]
    draw_lines(axes, lines, x_label, y_label, title)


def _is_curve(value: Any) -> bool:
    if not (isinstance(value, dict) and isinstance(value.get("x"), list) and isinstance(value.get("y"), list)):
        return False
    return len(value["x"]) == len(value["y"]) and _is_numeric(value["x"]) and _is_numeric(value["y"])


def _is_numeric(values: Any) -> bool:
    """Whether this is a list of numbers, some of which may be unknown, but not all."""
    if not isinstance(values, list) or not all(isinstance(item, int | float | None) for item in values):
        return False
    return any(item is not None for item in values)


def _numbers(values: list[float | None]) -> np.ndarray:
    return np.array([np.nan if value is None else value for value in values], dtype=float)
