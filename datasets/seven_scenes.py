"""7-Scenes: hand-held Kinect with poses of a depth tracker (METHOD, data sets and axis conventions)."""

from __future__ import annotations

from pathlib import Path

from ..recon.camera import Camera
from .calibration import Calibration, calibration_or
from .images import list_files
from .layout import choose_sequence
from .poses import checked_pose, read_matrix
from .recording import Entry, FileRecording

KINECT = Calibration(Camera(640, 480, 585.0, 585.0, 320.0, 240.0))
MARKER = "frame-*.color.*"


def matches(path: Path) -> bool:
    return any(path.glob(MARKER)) or any(path.glob(f"seq-*/{MARKER}"))


def read(path: Path) -> FileRecording:
    """Open a sequence, or the first sequence of a scene. Raises DataError."""
    sequence, notes = choose_sequence(path, MARKER)
    calibration, camera_notes = calibration_or(sequence, KINECT)
    images = list_files(sequence)
    frames = [stem.removesuffix(".color") for stem in images if stem.endswith(".color")]
    entries = [
        Entry(
            images[f"{frame}.color"],
            {"depth": images[f"{frame}.depth"]} if f"{frame}.depth" in images else {},
            checked_pose(read_matrix(sequence / f"{frame}.pose.txt")),  # OpenCV axes as they are
        )
        for frame in frames
    ]
    assumed = ("colour and depth come from two cameras a few centimetres apart and are taken as registered",)
    sensors = ("depth",) if any(entry.depths for entry in entries) else ()
    name = f"{sequence.resolve().parent.name}-{sequence.resolve().name}"
    notes += camera_notes + assumed
    return FileRecording(sequence, "7scenes", entries, sensors, calibration, name=name, notes=notes)
