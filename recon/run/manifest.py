"""The manifest of a run directory: what it holds and what that was made with."""

from __future__ import annotations

import hashlib
import json
import platform
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from pydantic import BaseModel, ConfigDict

from ..core.camera import Camera
from ..core.world_offset import NO_OFFSET

SCHEMA_VERSION = 2


class FrameRecord(BaseModel):
    """One frame of the run. `sensors` are those with a readable image; `source_index` counts in the data set."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    index: int
    source_index: int
    timestamp: float
    color: str  # file name in frames/color
    sensors: tuple[str, ...]
    T_world_camera: list[list[float]] | None = None


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
    camera: dict[str, float]
    sensors: tuple[str, ...]
    has_timestamps: bool
    reference_mesh: str | None = None
    registration_sigma_px: float = (
        0.0  # standard deviation of the offset between colour and depth, common to all frames
    )
    world_offset_m: tuple[float, float, float] = NO_OFFSET  # origin of the run in the world of the data set
    skipped: dict[str, str] = {}  # "source index[/sensor]" -> reason
    stages: dict[str, StageRecord] = {}
    outdated: dict[str, str] = {}  # stage whose files are no longer those of the run -> reason

    def pinhole_camera(self) -> Camera:
        """`camera` as a value."""
        fx, fy, cx, cy = (self.camera[key] for key in ("fx", "fy", "cx", "cy"))
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
