"""The manifest of a run directory: what it holds and what that was made with."""

from __future__ import annotations

import hashlib
import json
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, FiniteFloat, field_validator

from ..core.camera import Camera
from ..core.world_offset import NO_OFFSET

SCHEMA_VERSION = 2
CAMERA_FIELDS = ("width", "height", "fx", "fy", "cx", "cy")
MAX_SIDE_PX = 1 << 15  # of an image


def _file_name(name: str) -> str:
    """A run reads and writes below its own folder, whatever its manifest says."""
    if not name or name in (".", "..") or "/" in name or "\0" in name:
        raise ValueError(f"{name!r} is no name of a file or folder")
    return name


FileName = Annotated[str, AfterValidator(_file_name)]


class FrameRecord(BaseModel):
    """One frame of the run. `sensors` are those with a readable image; `source_index` counts in the data set."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    index: int
    source_index: int
    timestamp: FiniteFloat
    color: FileName  # file name in frames/color
    sensors: tuple[FileName, ...]
    T_world_camera: list[list[FiniteFloat]] | None = None

    @field_validator("T_world_camera")
    @classmethod
    def _matrix(cls, rows: list[list[float]] | None) -> list[list[float]] | None:
        if rows is not None and [len(row) for row in rows] != [4] * 4:
            raise ValueError("expected 4 rows of 4 numbers")
        return rows


class StageRecord(BaseModel):
    """A finished stage: what it was made with, and when."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    config_hash: str
    output: str = ""  # digest of what it made; of `preprocess`: of the frames themselves
    inputs: dict[str, str] = {}  # stage -> its `output` that this one was made from
    finished: str
    seconds: float
    versions: dict[str, str]
    facts: dict[str, Any] = {}  # settings and figures of the stage: seed, device, frames/s, peak memory ...


class Manifest(BaseModel):
    """`manifest.json`: what the run is made of."""

    model_config = ConfigDict(extra="forbid")
    schema_version: int = SCHEMA_VERSION
    dataset: str
    dataset_format: str
    name: str
    camera: dict[str, FiniteFloat]
    sensors: tuple[FileName, ...]
    has_timestamps: bool
    reference_mesh: str | None = None
    registration_sigma_px: FiniteFloat = (
        0.0  # standard deviation of the offset between colour and depth, common to all frames
    )
    world_offset_m: tuple[FiniteFloat, FiniteFloat, FiniteFloat] = (
        NO_OFFSET  # origin of the run in the world of the data set
    )
    skipped: dict[str, str] = {}  # "source index[/sensor]" -> reason
    stages: dict[str, StageRecord] = {}
    outdated: dict[str, str] = {}  # stage whose files are no longer those of the run -> reason

    @field_validator("camera")
    @classmethod
    def _pinhole(cls, camera: dict[str, float]) -> dict[str, float]:
        if set(camera) != set(CAMERA_FIELDS):
            raise ValueError(f"expected {', '.join(CAMERA_FIELDS)}")
        sizes = camera["width"], camera["height"]
        if (
            not all(1 <= size <= MAX_SIDE_PX and size % 1 == 0 for size in sizes)
            or min(camera["fx"], camera["fy"]) <= 0
        ):
            raise ValueError("no camera has this size and focal length")
        return camera

    def pinhole_camera(self) -> Camera:
        """`camera` as a value."""
        fx, fy, cx, cy = (self.camera[key] for key in CAMERA_FIELDS[2:])
        return Camera(int(self.camera["width"]), int(self.camera["height"]), fx, fy, cx, cy)


def config_hash(*parts: object) -> str:
    """Short, stable hash of JSON-like settings."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]


def library_versions() -> dict[str, str]:
    """Versions that decide a result."""
    versions = {"python": platform.python_version()}
    for name in ("uncle", "torch", "open3d", "numpy", "opencv-python-headless"):
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions
