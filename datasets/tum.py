"""TUM RGB-D: Kinect with motion capture; colour, depth and poses have clocks of their own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from ..recon.core.camera import Camera
from ..recon.core.depth_image import read_depth_values
from ..recon.core.errors import DataError
from ..recon.core.pose import NO_POSE
from ..recon.core.text import TextLine, parse_number, read_text, text_lines
from ..recon.core.time_stamps import SECONDS, TimeUnit, common_units, explain_mismatch
from .calibration import CAMERA_FILE, Calibration
from .camera_files import calibration_or
from .clocks import Stream, depth_delay
from .layout import ASSOCIATION_FILES, first_file
from .pose_files import FramePoses, poses_of_table
from .recording import Entry, FileRecording

MAX_DEPTH_GAP_S = 0.04  # a little over one frame: a wider gap pairs a colour image with another view
UNITS_PER_M = 5000.0
NEAR_M = 0.5  # rooms are rarely seen from nearer: the depth scale is questioned
ASSOCIATION = re.compile(r"([^\s,;]+)[\s,;]+(.+?\.(?:png|jpe?g)[\"']?)[\s,;]+([^\s,;]+)[\s,;]+(.+)", re.IGNORECASE)
TUM_NAME = re.compile(r"rgbd_dataset_freiburg([123])(?:_|\b)")

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
    """Whether the folder has `rgb.txt` and `depth.txt`, or a list of their pairs such as `associations.txt`."""
    return all((path / name).is_file() for name in ("rgb.txt", "depth.txt")) or _association_file(path) is not None


def read(path: Path) -> FileRecording:
    """Open a sequence. Raises DataError, also if the time stamps of its streams have nothing in common."""
    associations = _association_file(path)
    has_lists = (path / "rgb.txt").is_file() and (path / "depth.txt").is_file()
    if associations is not None and not has_lists:
        color, depth, notes = _read_associations(path, associations)
        pairs = [(index, index) for index in range(len(color.times))]
    else:
        color, depth, pairs, notes = _pair_lists(path)
    stamps = color.times[[index for index, _ in pairs]]
    poses = _poses(path, stamps, [color.files[index].stem for index, _ in pairs])
    entries = [
        Entry(color.files[first], {"depth": depth.files[second]}, pose, float(color.times[first]))
        for (first, second), pose in zip(pairs, poses.poses, strict=True)
    ]
    guess, guess_notes = _camera(path, depth.files)
    calibration, camera_notes = calibration_or(path, guess, depth.files)
    if camera_notes:
        camera_notes = (f"{camera_notes[0]}, with {calibration.depth_units_per_m:g} depth units a metre",)
    notes = (*(camera_notes or guess_notes), *notes, *poses.notes)
    return FileRecording(path, "tum", entries, ("depth",), calibration, notes=notes)


def _pair_lists(path: Path) -> tuple[Stream, Stream, list[tuple[int, int]], tuple[str, ...]]:
    """Streams of `rgb.txt` and `depth.txt`, pairs of their images at the same time, and notes. Raises DataError."""
    color, depth = _read_list(path / "rgb.txt"), _read_list(path / "depth.txt")
    units = common_units(color.times, depth.times)
    notes = _unit_notes(("rgb.txt", "depth.txt"), units)
    color, depth = (Stream(s.times * unit.seconds, s.files) for s, unit in zip((color, depth), units, strict=True))
    delay = depth_delay(color, depth)
    pairs = associate(color.times, depth.times - delay, MAX_DEPTH_GAP_S)
    if not pairs:
        rule = "images are not paired across"
        name = str(path / "rgb.txt")
        raise DataError(explain_mismatch(name, color.times, "depth.txt", depth.times, MAX_DEPTH_GAP_S, rule))
    if delay:
        late = f"{abs(delay) * 1e3:.0f} ms {'later' if delay > 0 else 'earlier'}"
        notes += (f"depth is stamped {late} than the colour that shows the same motion: paired accordingly",)
    if dropped := len(color.times) - len(pairs):
        notes += (f"{dropped} of {len(color.times)} colour images have no depth within {MAX_DEPTH_GAP_S} s: left out",)
    return color, depth, pairs, notes


def _unit_notes(names: Sequence[str], units: Sequence[TimeUnit]) -> tuple[str, ...]:
    pairs = zip(names, units, strict=True)
    return tuple(f"time stamps of {name} are read as {unit.name}" for name, unit in pairs if unit != SECONDS)


def _association_file(path: Path) -> Path | None:
    return first_file(path / name for name in ASSOCIATION_FILES)


def _read_list(path: Path) -> Stream:
    """Time stamps as in the file, increasing, and the images of `rgb.txt` or `depth.txt`. Raises DataError."""
    rows: dict[float, Path] = {}
    for line in text_lines(path):
        time, _, name = _split(line.text)
        stamp = parse_number(time)
        if stamp is None or not name:
            if not rows and not any(character.isdigit() for character in line.text):
                continue  # names of columns
            raise DataError(f"{path}, line {line.number}: expected `timestamp filename`, found {line.text[:60]!r}")
        rows.setdefault(stamp, _image(path.parent, name))
    return _stream(path, rows)


def _read_associations(path: Path, file: Path) -> tuple[Stream, Stream, tuple[str, ...]]:
    """Colour, depth and notes of lines `timestamp filename timestamp filename`, colour or depth first."""
    pairs = sorted(_association(path, file, line) for line in text_lines(file))
    if not pairs:
        raise DataError(f"{file} names no images")
    times = np.array([[stamp for stamp, _ in pair] for pair in pairs])
    units = common_units(times[:, 0], times[:, 1])
    streams = [
        Stream(times[:, side] * unit.seconds, [pair[side][1] for pair in pairs]) for side, unit in enumerate(units)
    ]
    return streams[0], streams[1], (f"pairs are those of {file.name}", *_unit_notes((file.name,), units[:1]))


def _association(path: Path, file: Path, line: TextLine) -> tuple[tuple[float, Path], tuple[float, Path]]:
    """Time stamp and file of colour, then of depth."""
    match = ASSOCIATION.fullmatch(line.text)
    first, second = (parse_number(match[group]) if match else None for group in (1, 3))
    if match is None or first is None or second is None:
        raise DataError(
            f"{file}, line {line.number}: expected `timestamp filename timestamp filename`, found {line.text[:60]!r}"
        )
    pair = (first, _image(path, match[2])), (second, _image(path, match[4]))
    return (pair[1], pair[0]) if "depth" in match[2].lower() else pair


def _split(text: str) -> tuple[str, str, str]:
    """Time stamp, separator and the rest of a line: a file name, which may contain blanks."""
    match = re.fullmatch(r"([^\s,;]+)([\s,;]+)(.*)", text)
    return (match[1], match[2], match[3]) if match else (text, "", "")


def _image(folder: Path, name: str) -> Path:
    """The file that a list calls `name`; columns after the name do not count."""
    name = name.strip().strip("\"'").replace("\\", "/")
    if not (folder / name).is_file():
        shorter = re.match(r".*?\.(?:png|jpe?g)(?=[\s,;]|$)", name, re.IGNORECASE)
        name = shorter[0] if shorter else name
    return folder / name


def _stream(path: Path, rows: dict[float, Path]) -> Stream:
    times = sorted(time for time in rows if np.isfinite(time))
    if not times:
        raise DataError(f"{path} names no images")
    return Stream(np.array(times), [rows[time] for time in times])


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


def _poses(path: Path, stamps: np.ndarray, stems: Sequence[str]) -> FramePoses:
    file = first_file([path / "groundtruth.txt", path / "pose.txt", path / "poses.txt"])
    return FramePoses([NO_POSE] * len(stamps)) if file is None else poses_of_table(file, stems, stamps)


def _camera(path: Path, depths: Sequence[Path]) -> tuple[Calibration, tuple[str, ...]]:
    """The camera by TUM's own name of the folder, or of the recording in the head of a list; else a default.

    Any other camera can write this layout, so what is assumed is reported.
    """
    heads = [read_text(file)[:200] for file in (path / "rgb.txt", path / "groundtruth.txt") if file.is_file()]
    units = f"{UNITS_PER_M:g} depth units a metre"
    for text in (path.resolve().name, *heads):
        if match := TUM_NAME.search(text):
            return CALIBRATIONS[match[1]], (f"the camera of freiburg{match[1]} and {units} are assumed, by the name",)
    note = (
        f"neither folder nor lists have a name of TUM's (rgbd_dataset_freiburg1_...): a default Kinect (f 525, c 319.5 "
        f"239.5) and {units} are assumed{_doubt(depths)}; is that right? A {CAMERA_FILE} states camera and depth_scale"
    )
    return UNKNOWN_KINECT, (note,)


def _doubt(depths: Sequence[Path]) -> str:
    """What speaks against TUM's depth scale: the median depth of a few images, if it is nearer than rooms are."""
    measured = []
    for file in depths[:: max(1, len(depths) // 4)]:
        with suppress(DataError):  # reported when the frame is read
            values = read_depth_values(file)
            measured.append(values[values > 0])
    values = np.concatenate(measured) if measured else np.zeros(0)
    median = float(np.median(values)) if values.size else np.inf
    if values.dtype.kind == "f" or median >= NEAR_M * UNITS_PER_M:
        return ""
    return f" (the median depth is {median / UNITS_PER_M:.2f} m then; with 1000 units it is {median / 1000:.2f} m)"
