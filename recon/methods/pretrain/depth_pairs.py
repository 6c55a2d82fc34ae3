"""What a confidence network learns from: measurements of one sensor beside the true depth, in one compact file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
from torch import Tensor

from ...core.array_files import read_npz
from ...core.errors import ConfigError, DataError
from ...core.events import OnEvent, ignore, track_progress
from ...core.files import DEPTH_UNITS_PER_M, atomic_path, encode_metres

TRUTH = "gt"
FORMAT = "uncle depth pairs"
COMMAND = "uncle pretrain confidence --prepare"


class DepthSource(Protocol):
    """The part of a recording, or of the frames of a run, that is read here."""

    sensors: tuple[str, ...]

    def __len__(self) -> int:
        """Number of frames."""

    def depth(self, index: int, sensor: str) -> Tensor:
        """(H, W) float32 metres, 0 = no measurement. Raises DataError."""


@dataclass(frozen=True)
class DepthPairs:
    """reading, truth (N, H, W) uint16 millimetres, 0 = none; scene (N,) int64 number of the recording of each."""

    sensor: str
    reading: np.ndarray
    truth: np.ndarray
    scene: np.ndarray

    def __len__(self) -> int:
        return len(self.scene)

    @staticmethod
    def collect(
        sources: Iterable[tuple[str, DepthSource]], sensor: str, frames: int, on_event: OnEvent = ignore
    ) -> DepthPairs:
        """Up to `frames` evenly spread frames of each recording, given with its name. Raises DataError, ConfigError."""
        readings, truths, scenes = [], [], []
        for number, (name, source) in enumerate(sources):
            missing = [wanted for wanted in (sensor, TRUTH) if wanted not in source.sensors]
            if missing:
                raise ConfigError(
                    f"{name} has no sensor {missing[0]!r}, only {', '.join(source.sensors)}; the sensor and its true "
                    f"depth, {TRUTH}, are needed: `uncle synth` makes both"
                )
            chosen = spread(len(source), frames)
            for index in track_progress(chosen, len(chosen), f"reading {name}", on_event):
                readings.append(_millimetres(source.depth(index, sensor)))
                truths.append(_millimetres(source.depth(index, TRUTH)))
                scenes.append(number)
                if readings[-1].shape != readings[0].shape:
                    raise DataError(
                        f"{name}: images of {readings[-1].shape}, but {readings[0].shape} before; train on one size"
                    )
        if not readings:
            raise DataError("there is no frame to learn from; give at least one data set")
        return DepthPairs(sensor, np.stack(readings), np.stack(truths), np.array(scenes))

    def save(self, path: Path) -> None:
        """One compressed file. Raises RunError."""
        with atomic_path(path) as temporary, open(temporary, "wb") as file:
            np.savez_compressed(
                file, format=FORMAT, sensor=self.sensor, scene=self.scene,
                reading=packed(self.reading), truth=packed(self.truth),
            )  # fmt: skip

    @staticmethod
    def load(path: Path) -> DepthPairs:
        """Raises DataError."""
        arrays = load_arrays(path, FORMAT, COMMAND)
        try:
            reading, truth = unpacked(arrays["reading"]), unpacked(arrays["truth"])
            pairs = DepthPairs(str(arrays["sensor"]), reading, truth, arrays["scene"])
        except (KeyError, ValueError) as error:
            raise DataError(f"{path} is damaged ({error}); make it again with `{COMMAND}`") from error
        if reading.shape != truth.shape or pairs.scene.shape != (len(reading),) or pairs.scene.dtype.kind not in "iu":
            raise DataError(f"{path} is damaged: its images are not of one shape; make it again with `{COMMAND}`")
        return pairs


def load_arrays(path: Path, kind: str, command: str) -> dict[str, np.ndarray]:
    """The arrays of an npz file of training data of that `kind`. Raises DataError naming the `command` for it."""
    try:
        arrays = read_npz(path)
    except FileNotFoundError as error:
        raise DataError(f"there is no file {path}") from error
    except Exception as error:  # of many types, for an archive or a header that is damaged
        raise DataError(f"cannot read {path}: not a whole file of training data; make it with `{command}`") from error
    if str(arrays.get("format")) != kind:
        raise DataError(f"{path} is not a file of training data of this kind; make it with `{command}`")
    return arrays


def spread(count: int, wanted: int) -> list[int]:
    """At most `wanted` of `count` positions, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, wanted)).round().astype(int)).tolist()


def packed(images: np.ndarray) -> np.ndarray:
    """(N, H, W) uint16 -> (2, N, H, W) uint8: differences along the rows, low and high bytes apart; deflates well."""
    steps = np.diff(images, axis=-1, prepend=images.dtype.type(0))  # modulo 2^16
    return np.stack([steps & 255, steps >> 8]).astype(np.uint8)


def unpacked(planes: np.ndarray) -> np.ndarray:
    """The inverse of `packed`. Raises ValueError for anything that it does not return."""
    if planes.ndim != 4 or len(planes) != 2 or planes.dtype != np.uint8 or planes.size == 0:
        raise ValueError(f"images are packed as (2, N, H, W) uint8, not {planes.shape} {planes.dtype}")
    steps = planes[0].astype(np.uint16) | planes[1].astype(np.uint16) << 8
    return np.cumsum(steps, axis=-1, dtype=np.uint16)


def _millimetres(depth: Tensor) -> np.ndarray:
    return encode_metres(depth.numpy(), DEPTH_UNITS_PER_M)
