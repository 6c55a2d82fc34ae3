"""TUM RGB-D: Kinect with motion capture; colour, depth and poses have clocks of their own."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..recon.core.camera import Camera
from ..recon.core.errors import DataError
from .calibration import CAMERA_FILE, Calibration, calibration_or
from .clocks import Stream, depth_delay
from .layout import first_file
from .poses import no_overlap, poses_at
from .recording import Entry, FileRecording

MAX_DEPTH_GAP_S = 0.04  # a little over one frame: a wider gap pairs a colour image with another view
UNITS_PER_M = 5000.0

# Published calibration of the three colour cameras; depth is registered to colour and bent like it.
CALIBRATIONS = {
    "1": Calibration(
        Camera(640, 480, 517.3, 516.5, 318.6, 255.3), UNITS_PER_M, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)
    ),
    "2": Calibration(
        Camera(640, 480, 520.9, 521.0, 325.1, 249.7), UNITS_PER_M, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    ),
    "3": Calibration(Camera(640, 480, 535.4, 539.2, 320.1, 247.6), UNITS_PER_M),  # published without distortion
}
UNKNOWN_KINECT = Calibration(Camera(640, 480, 525.0, 525.0, 319.5, 239.5), UNITS_PER_M)


def matches(path: Path) -> bool:
    """Whether the folder has `rgb.txt` and `depth.txt`."""
    return (path / "rgb.txt").is_file() and (path / "depth.txt").is_file()


def read(path: Path) -> FileRecording:
    """Open a sequence. Raises DataError, also if the time stamps of its streams have nothing in common."""
    color_times, color_names = read_list(path / "rgb.txt")
    depth_times, depth_names = read_list(path / "depth.txt")
    delay = depth_delay(
        Stream(color_times, [path / name for name in color_names]),
        Stream(depth_times, [path / name for name in depth_names]),
    )
    pairs = associate(color_times, depth_times - delay, MAX_DEPTH_GAP_S)
    if not pairs:
        raise DataError(no_overlap(str(path / "rgb.txt"), color_times, "depth.txt", depth_times))
    stamps = color_times[[color for color, _ in pairs]]
    entries = [
        Entry(path / color_names[color], {"depth": path / depth_names[depth]}, pose, float(color_times[color]))
        for (color, depth), pose in zip(pairs, _poses(path, stamps), strict=True)
    ]
    guess, guess_notes = _camera(path)
    calibration, camera_notes = calibration_or(path, guess)
    dropped = len(color_times) - len(pairs)
    notes = camera_notes or guess_notes
    if delay:
        late = f"{abs(delay) * 1e3:.0f} ms {'later' if delay > 0 else 'earlier'}"
        notes += (f"depth is stamped {late} than the colour that shows the same motion: paired accordingly",)
    if dropped:
        notes += (f"{dropped} of {len(color_times)} colour images have no depth within {MAX_DEPTH_GAP_S} s: left out",)
    return FileRecording(path, "tum", entries, ("depth",), calibration, notes=notes)


def read_list(path: Path) -> tuple[np.ndarray, list[str]]:
    """(N,) increasing time stamps in seconds and N file names of `rgb.txt` or `depth.txt`. Raises DataError."""
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"cannot read {path}: {error}") from error
    rows: dict[float, str] = {}
    for number, line in enumerate(lines, start=1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            rows.setdefault(float(words[0]), words[1])
        except (ValueError, IndexError) as error:
            raise DataError(f"{path}, line {number}: expected `timestamp filename`") from error
    times = sorted(time for time in rows if np.isfinite(time))
    if not times:
        raise DataError(f"{path} names no images")
    return np.array(times), [rows[time] for time in times]


def associate(first: np.ndarray, second: np.ndarray, max_gap_s: float) -> list[tuple[int, int]]:
    """Pairs (i, j) of increasing stamps at most `max_gap_s` apart, the closest first; each stamp is used once."""
    start = np.searchsorted(second, first - max_gap_s)
    stop = np.searchsorted(second, first + max_gap_s, side="right")
    close = [(abs(second[j] - first[i]), i, j) for i in range(len(first)) for j in range(start[i], stop[i])]
    used_first, used_second, pairs = set(), set(), []
    for _, i, j in sorted(close):
        if i not in used_first and j not in used_second:
            used_first.add(i)
            used_second.add(j)
            pairs.append((i, j))
    return sorted(pairs)


def _poses(path: Path, stamps: np.ndarray) -> list[np.ndarray | None]:
    file = first_file([path / "groundtruth.txt", path / "pose.txt"])
    return [None] * len(stamps) if file is None else poses_at(file, stamps)


def _camera(path: Path) -> tuple[Calibration, tuple[str, ...]]:
    """The camera from the folder's name, else from the recording's name in the head of a list; else a default."""
    heads = [file.read_text()[:200] for file in (path / "rgb.txt", path / "groundtruth.txt") if file.is_file()]
    for text in (path.resolve().name, *heads):
        if match := re.search(r"(?:freiburg|fr)[ _-]?([123])", text):
            return CALIBRATIONS[match[1]], ()
    note = (
        "neither folder nor lists name freiburg1, 2 or 3: a default Kinect is assumed (f 525, c 319.5 239.5); "
        f"a {CAMERA_FILE} states another"
    )
    return UNKNOWN_KINECT, (note,)
