"""Pictures of each sensor of a run: colour, depth, beta and, where it is known, true error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.errors import DataError
from ..core.events import OnEvent, Warn, ignore
from ..core.files import write_bytes
from ..evaluation.sensor_frames import SensorFrame, estimated_sensors, read_sensor_frame, spread_frames
from ..run.directory import RunDirectory
from ..run.frames import RunFrames
from .charts import ColorScale, encode_figure, new_figure, plain, show_picture

_ROWS = 3


@dataclass(frozen=True)
class SensorScales:
    """Colour scales that all sensors of a run share, so that pictures can be compared; beta and error share one."""

    depth: ColorScale
    error: ColorScale


def draw_sensors(
    run: RunDirectory,
    out: Path,
    on_event: OnEvent = ignore,
    sensors: Sequence[str] | None = None,
    frame: int | None = None,
) -> list[Path]:
    """Write `out`/sensor_NAME.png for every sensor that has depth, or for `sensors`; returns the files.

    A few frames are shown, or only `frame`. Raises RunError.
    """
    frames = RunFrames(run)
    rows_by_sensor: dict[str, list[SensorFrame]] = {}
    for sensor in estimated_sensors(frames) if sensors is None else sensors:
        indices = spread_frames(frames, sensor, _ROWS) if frame is None else [frame]
        try:
            rows_by_sensor[sensor] = [read_sensor_frame(frames, index, sensor) for index in indices]
        except DataError as error:
            on_event(Warn(f"no picture of sensor {sensor}: {error}"))
    rows_by_sensor = {sensor: rows for sensor, rows in rows_by_sensor.items() if rows}
    if not rows_by_sensor:
        return []
    scales = common_scales([row for rows in rows_by_sensor.values() for row in rows])
    written = []
    for sensor, rows in rows_by_sensor.items():
        path = out / f"sensor_{sensor}.png"
        colors = [_color(frames, row.index, on_event) for row in rows]
        write_bytes(path, sensor_sheet(sensor, rows, colors, scales))
        written.append(path)
    return written


def common_scales(rows: list[SensorFrame]) -> SensorScales:
    """Depth up to its 99th percentile; beta and error up to the 95th of whichever is larger."""
    highest_beta = _percentile([row.beta for row in rows], 95)
    highest_error = _percentile([row.error for row in rows], 95)
    return SensorScales(
        ColorScale("depth [m]", 0.0, max(_percentile([row.depth for row in rows], 99), 0.1), "viridis"),
        ColorScale("[cm]", 0.0, max(highest_beta, highest_error, 1e-3), "turbo", 100.0),
    )


def sensor_sheet(sensor: str, rows: list[SensorFrame], colors: list[np.ndarray], scales: SensorScales) -> bytes:
    """One row per frame, with columns for colour, depth, beta and true error as far as they are known; PNG."""
    columns = ["colour", "depth"]
    columns += ["beta (learned)"] if any(row.beta is not None for row in rows) else []
    columns += ["true error"] if any(row.error is not None for row in rows) else []
    height, width = rows[0].depth.shape
    cell = 3.3
    figure = new_figure(cell * len(columns), (cell * height / width) * len(rows) + 1.2)
    ratios = [*[cell * height / width] * len(rows), 0.13]  # the last row holds the colour bars
    grid = figure.subplots(len(rows) + 1, len(columns), squeeze=False, height_ratios=ratios)
    for line, row, color in zip(grid, rows, colors, strict=False):
        for axes, column in zip(line, columns, strict=True):
            picture = color if column == "colour" else _panel(row, column, scales)
            show_picture(axes, picture, column if row is rows[0] else "")
        line[0].set_ylabel(f"frame {row.index}")
    grid[-1, 0].axis("off")
    for axes, column in zip(grid[-1, 1:], columns[1:], strict=True):
        scale = scales.depth if column == "depth" else scales.error
        scale.draw_bar(figure, cax=axes, orientation="horizontal")
    figure.suptitle(plain(f"Sensor {sensor}"), fontsize=13)
    return encode_figure(figure)


def _color(frames: RunFrames, index: int, on_event: OnEvent) -> np.ndarray:
    """(H, W, 3) uint8; grey where the colour image cannot be read."""
    try:
        return frames.color(index).numpy()
    except DataError as error:
        on_event(Warn(str(error)))
        return np.full((frames.camera.height, frames.camera.width, 3), 128, np.uint8)


def _panel(row: SensorFrame, column: str, scales: SensorScales) -> np.ndarray:
    if column == "depth":
        return _painted(row.depth, scales.depth)
    values = row.beta if column.startswith("beta") else row.error
    return _painted(np.full(row.depth.shape, np.nan) if values is None else values, scales.error)


def _painted(values: np.ndarray, scale: ColorScale) -> np.ndarray:
    """(H, W, 3) uint8; light grey where a value is unknown."""
    return np.where(np.isfinite(values)[..., None], scale.paint(values), np.uint8(235))


def _percentile(images: list[np.ndarray | None], percent: float) -> float:
    values = np.concatenate([image[np.isfinite(image)] for image in images if image is not None] or [np.zeros(0)])
    return float(np.percentile(values, percent)) if len(values) else 0.0
