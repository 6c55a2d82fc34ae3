"""Charts of a camera: its path from two sides, and its error and predicted sigma over time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..core.files import write_bytes
from ..evaluation.tracking_metrics import pose_covariances, predicted_sigmas, record_rows
from ..evaluation.trajectory_pair import CameraPath
from .charts import Line, draw_lines, encode_figure, new_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_TRUE, _ESTIMATE, _ALIGNED, _LOST = "#8a8f98", "#1f77b4", "#2ca02c", "#d62728"
_BAND, _SIGMA = "#c9cdd3", "1 sigma, predicted by the tracker"
_STATUS_COLORS = {"weak": "#ff7f0e", "relocalised": "#9467bd"}
_HEADROOM = 1.15
_MAX_SIGMA_RATIO = 3.0  # the axis ends at this multiple of the largest error, so that the errors stay visible


def draw_camera_path(path: CameraPath, out: Path) -> list[Path]:
    """Write `out`/trajectory.png and, with true poses or a tracking record, `out`/drift.png; returns the files.

    Raises DataError if no pose is finite, RunError.
    """
    charts = {"trajectory.png": trajectory_chart(path), "drift.png": drift_chart(path)}
    written = []
    for name, chart in charts.items():
        if chart is not None:
            write_bytes(out / name, chart)
            written.append(out / name)
    return written


def trajectory_chart(path: CameraPath) -> bytes:
    """The camera centres in the plane of the two largest extents and from its side, equal axes in metres; PNG.

    The estimate is aligned to the true poses where they are known. Raises DataError if no pose is finite.
    """
    posed, matched = path.posed, path.matched
    T = np.eye(4) if matched is None else matched.T_true_estimate
    centres = (T @ posed.T_world_camera)[:, :3, 3]
    true = path.reference.finite() if path.reference is not None and matched is not None else None
    extent = np.ptp(centres if true is None else true.T_world_camera[:, :3, 3], axis=0)
    first, second, third = np.argsort(-extent, kind="stable")
    figure = new_figure(11.0, 5.2)
    for axes, pair, title in zip(
        figure.subplots(1, 2), ((first, second), (first, third)),
        ("Camera path, in the plane of its largest extent", "Camera path, from the side"), strict=True,
    ):  # fmt: skip
        lines = [] if true is None else [_curve("true", true.T_world_camera[:, pair, 3], "-", _TRUE)]
        x, y = _broken(posed.timestamps, centres, path.lost_spans).T[list(pair)]
        lines.append(Line("estimated" if true is None else "estimated, aligned", x, y, "-", _ESTIMATE))
        lines += _lost_lines(path, centres[:, pair], None if true is None else true.T_world_camera[:, pair, 3])
        lines += _status_marks(path, centres[:, pair])
        lines.append(_curve("start", centres[:1, pair], "*", "black"))
        draw_lines(axes, lines, f"{'xyz'[pair[0]]} [m]", f"{'xyz'[pair[1]]} [m]", title)
        axes.lines[-1].set_markersize(11)
        axes.set_aspect("equal", adjustable="datalim")
    return encode_figure(figure)


def drift_chart(path: CameraPath) -> bytes | None:
    """Position and rotation error over time, unaligned and aligned, predicted sigma, and lost frames; PNG.

    Without true poses the predicted sigma alone; None if there is neither. Raises DataError if no pose is finite.
    """
    matched = path.matched
    sigmas = None
    if path.record is not None:
        sigmas = predicted_sigmas(pose_covariances(path.record, path.posed.timestamps))
    if matched is None and sigmas is None:
        return None
    figure = new_figure(11.0, 6.0)
    names, factors = ("position error [cm]", "rotation error [°]"), (100.0, float(np.degrees(1.0)))
    for panel, axes in enumerate(figure.subplots(2, 1, sharex=True)):
        errors = {}
        if matched is not None:
            measure = matched.position_errors if panel == 0 else matched.rotation_errors
            errors = {"unaligned": measure(aligned=False), "aligned": measure(aligned=True)}
        sigma = None if sigmas is None else sigmas[panel] * factors[panel]
        _draw_errors(axes, path, {name: values * factors[panel] for name, values in errors.items()}, sigma)
        axes.set_ylabel(names[panel])
    axes.set_xlabel("time [s]" if path.has_clock else "frame")
    title = "Error over time" if matched is not None else "Predicted error over time"
    figure.suptitle(title, fontsize=12)
    return encode_figure(figure)


def _curve(name: str, points: np.ndarray, style: str, color: str) -> Line:
    """The curve through points (N, 2)."""
    return Line(name, points[:, 0], points[:, 1], style, color)


def _draw_errors(axes: Axes, path: CameraPath, errors: dict[str, np.ndarray], sigma: np.ndarray | None) -> None:
    """One panel: errors of the matched poses by name and `sigma` of the posed frames, in the unit of the axis."""
    for number, (begin, end) in enumerate(path.lost_spans):
        label = "lost" if number == 0 else None
        axes.axvspan(begin - path.start_time, end - path.start_time, color=_LOST, alpha=0.15, lw=0, label=label)
    lines = []
    if sigma is not None:
        times, values = _over_time(path, path.posed.timestamps, sigma)
        axes.fill_between(times, 0, values, color=_BAND, linewidth=0, label="" if not errors else _SIGMA)
        lines += [] if errors else [Line(_SIGMA, times, values, "-", _ESTIMATE)]
    if path.matched is not None:
        for (name, values), color in zip(errors.items(), (_ESTIMATE, _ALIGNED), strict=True):
            lines.append(_curve(name, _over_time(path, path.matched.timestamps, values).T, "-", color))
    draw_lines(axes, lines, "", "")
    axes.set_ylim(0, _top(list(errors.values()), sigma))
    axes.legend(frameon=False, fontsize=9, loc="upper left")


def _over_time(path: CameraPath, times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(2, N) times since the first frame and values, with gaps where the camera was lost."""
    return _broken(times, np.column_stack([times - path.start_time, values]), path.lost_spans).T


def _top(errors: list[np.ndarray], sigma: np.ndarray | None) -> float:
    """The upper end of an axis of errors: all errors are shown, sigmas up to a multiple of the largest error."""
    worst = max((float(values.max()) for values in errors), default=0.0)
    finite = np.zeros(1) if sigma is None else np.append(sigma[np.isfinite(sigma)], 0.0)
    usual = worst if errors and worst > 0 else float(np.quantile(finite, 0.9))
    top = max(worst, min(float(finite.max()), _MAX_SIGMA_RATIO * usual))
    return _HEADROOM * top if top > 0 else 1.0


def _broken(times: np.ndarray, rows: np.ndarray, spans: list[tuple[float, float]]) -> np.ndarray:
    """`rows` (N, C) at increasing `times` (N,) with a row of NaN in every span, so that a line has a gap there."""
    cuts = [int(np.searchsorted(times, 0.5 * (begin + end))) for begin, end in spans]
    return np.insert(rows.astype(float), cuts, np.nan, axis=0)


def _lost_lines(path: CameraPath, centres: np.ndarray, true: np.ndarray | None) -> list[Line]:
    """The true path of the lost frames or, where it is unknown, straight lines between the poses around them."""
    pieces = []
    for begin, end in path.lost_spans:
        if true is not None and path.reference is not None:
            times = path.reference.finite().timestamps
            pieces.append(true[(times >= begin - 1e-4) & (times <= end + 1e-4)])
        else:
            times = path.posed.timestamps
            before, after = np.flatnonzero(times < begin + 1e-4)[-1:], np.flatnonzero(times > end - 1e-4)[:1]
            pieces.append(centres[np.concatenate([before, after])])
    if not pieces:
        return []
    gap = np.full((1, 2), np.nan)
    x, y = np.concatenate([row for piece in pieces for row in (piece, gap)]).T
    return [Line("lost", x, y, "-" if true is not None else ":", _LOST)]


def _status_marks(path: CameraPath, centres: np.ndarray) -> list[Line]:
    if path.record is None:
        return []
    rows = record_rows(path.record, path.posed.timestamps)
    statuses = np.array(["" if row < 0 else path.record.frames[row].status for row in rows])
    return [
        _curve(f"{status} ({np.count_nonzero(statuses == status)})", centres[statuses == status], "o", color)
        for status, color in _STATUS_COLORS.items()
        if (statuses == status).any()
    ]
