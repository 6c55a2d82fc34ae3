"""7-Scenes: hand-held Kinect with poses of a depth tracker; units and axes: docs/uncle-paper.md, Data sets."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ..recon.core.camera import Camera
from ..recon.core.depth_image import DEPTH_SUFFIXES
from ..recon.core.pose import NO_POSE, Pose
from ..recon.core.pose_tables import read_pose
from .calibration import CAMERA_FILE, Calibration
from .camera_files import calibration_or
from .images import list_files
from .layout import choose_sequence
from .pose_files import FramePoses
from .recording import FileRecording, frame_entries

# The data set names one camera, that of depth and poses; its images are the raw ones of the Kinect's colour camera.
# Its place: the Kinect's baseline as built. Its two angles and its focal length: where the rims of near things in the
# depth images meet edges of colour best, measured on redkitchen (each third of the frames finds them to about 1 pixel).
T_COLOR_DEPTH = np.eye(4)
T_COLOR_DEPTH[:3, :3] = Rotation.from_rotvec([0.003, 0.0, 0.007]).as_matrix()
T_COLOR_DEPTH[0, 3] = -0.025
KINECT = Calibration(
    Camera(640, 480, 585.0, 585.0, 320.0, 240.0),
    color_camera=Camera(640, 480, 527.0, 527.0, 320.0, 240.0),
    T_color_depth=T_COLOR_DEPTH,
)
MARKER = "frame-*.color.*"


def matches(path: Path) -> bool:
    """Whether the folder has images such as `frame-000000.color.png`, of the folder or of a sequence in it."""
    return any(path.glob(MARKER)) or any(path.glob(f"seq-*/{MARKER}"))


def read(path: Path) -> FileRecording:
    """Open a sequence, or the first sequence of a scene. Raises DataError."""
    sequence, notes = choose_sequence(path, MARKER)
    images, files = list_files(sequence), list_files(sequence, (".txt",))
    colors, depths = _of_kind(images, "color"), _of_kind(list_files(sequence, DEPTH_SUFFIXES), "depth")
    # 3DMatch and BundleFusion have the layout of 7-Scenes, but another camera, which they state.
    calibration, camera_notes = calibration_or([sequence, sequence.resolve().parent], KINECT, list(depths.values()))
    found = _of_kind(files, "pose")
    poses = FramePoses([read_pose(found[frame]) if frame in found else _missing(found) for frame in colors])
    entries = frame_entries(colors, {"depth": depths}, poses)  # OpenCV axes as they are
    assumed: tuple[str, ...] = ()
    if calibration is KINECT:
        what = "the Kinect of 7-Scenes (f 585) is assumed, and colour is registered to depth by a typical calibration"
        assumed = (f"{what} of that data set; a {CAMERA_FILE} states another",)
    elif calibration.color_camera is None:
        assumed = ("colour is taken as registered to depth, as the camera file names no other camera",)
    sensors = ("depth",) if any(entry.depths for entry in entries) else ()
    name = f"{sequence.resolve().parent.name}-{sequence.resolve().name}"
    notes += camera_notes + assumed
    return FileRecording(sequence, "7scenes", entries, sensors, calibration, name=name, notes=notes)


def _of_kind(files: Mapping[str, Path], kind: str) -> dict[str, Path]:
    """Frame -> its file, of those called `<frame>.<kind>`."""
    ending = f".{kind}"
    return {stem[: -len(ending)]: path for stem, path in files.items() if stem.lower().endswith(ending)}


def _missing(found: Mapping[str, Path]) -> Pose:
    return Pose(None, "it has no .pose.txt") if found else NO_POSE
