"""The unit of depth images: integers have that of the calibration, float values are metres unless their range says
otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..recon.core.depth_image import read_depth_values
from ..recon.core.errors import DataError

SAMPLES = 5  # images of a sensor from which the range of float depth is found
MAX_MEDIAN_M = 50.0  # no recording of surfaces has a larger median depth; in millimetres it would be 5 cm
MAX_DEPTH_M = 10_000.0  # renderers write larger values where they see nothing
MAX_HALF = 65504.0  # the largest 16-bit float, for nothing as well


@dataclass(frozen=True)
class DepthUnits:
    """integer_per_m  value of an integer pixel at one metre; real_per_m  the same of float pixels."""

    integer_per_m: float
    real_per_m: float = 1.0

    def metres(self, values: np.ndarray) -> np.ndarray:
        """(H, W) values of an image -> float32 metres."""
        depth = values.astype(np.float32)
        if values.dtype.kind != "f":
            depth /= np.float32(self.integer_per_m)
            return depth
        depth /= np.float32(self.real_per_m)
        return np.where(depth < MAX_DEPTH_M, depth, np.float32(0))


def sensor_units(
    sensors: Mapping[str, Sequence[Path]], units_per_m: float
) -> tuple[dict[str, DepthUnits], tuple[str, ...]]:
    """The units of each sensor from a few of its files, and a note on each sensor with float images.

    `units_per_m` is that of the calibration. Float images with a median of more than 50 are in that unit, too; in
    millimetres where that is the metre.
    """
    units, notes = {}, []
    for sensor, files in sensors.items():
        median = _median_of_reals(files)
        if median is None:
            units[sensor] = DepthUnits(units_per_m)
        elif median <= MAX_MEDIAN_M:
            units[sensor] = DepthUnits(units_per_m)
            notes.append(f"sensor {sensor}: float depth is read as metres (median {median:.3g} m)")
        else:
            real_per_m = units_per_m if units_per_m > 1 else 1000.0
            units[sensor] = DepthUnits(units_per_m, real_per_m)
            notes.append(
                f"sensor {sensor}: float depth has a median of {median:.4g} and is read as {real_per_m:g} units per "
                f"metre ({median / real_per_m:.3g} m), not as metres"
            )
    return units, tuple(notes)


def _median_of_reals(files: Sequence[Path]) -> float | None:
    """Median of the measurements of a few images; None if the first that can be read does not hold float values."""
    chosen = [files[index] for index in np.unique(np.linspace(0, len(files) - 1, SAMPLES).astype(int))] if files else []
    measured = []
    for file in chosen:
        with suppress(DataError):  # reported when the frame is read
            values = read_depth_values(file)
            if values.dtype.kind != "f":
                return None
            measured.append(values[(values > 0) & (values < MAX_HALF)])
    joined = np.concatenate(measured) if measured else np.zeros(0)
    return float(np.median(joined)) if len(joined) else None
