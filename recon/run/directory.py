"""The run directory: every path, the manifest, and which stages are done."""

from __future__ import annotations

import hashlib
import json
import platform
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from ..core.camera import Camera
from ..core.errors import RunError
from ..core.files import write_text

SCHEMA_VERSION = 1


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
    registration_sigma_px: float = 0.0  # how far colour may lie beside its depth, by an error that all frames share
    skipped: dict[str, str] = {}  # "source index[/sensor]" -> reason
    stages: dict[str, StageRecord] = {}


class RunDirectory:
    """Paths and manifest of one run. Reading never changes the folder."""

    def __init__(self, root: Path) -> None:
        self.root = Path(root)

    # --- paths -------------------------------------------------------------------------------------------------
    @property
    def manifest_path(self) -> Path:
        return self.root / "manifest.json"

    @property
    def frames_path(self) -> Path:
        return self.root / "frames" / "frames.json"

    @property
    def config_path(self) -> Path:
        return self.root / "config.toml"

    @property
    def trajectory_path(self) -> Path:
        return self.root / "trajectory.txt"

    @property
    def reference_trajectory_path(self) -> Path:
        return self.root / "trajectory_gt.txt"

    @property
    def tracking_path(self) -> Path:
        return self.root / "tracking.json"

    @property
    def sensors_path(self) -> Path:
        return self.root / "sensors.json"

    @property
    def field_path(self) -> Path:
        return self.root / "map" / "field.pt"

    @property
    def noise_model_path(self) -> Path:
        return self.root / "map" / "noise_model.pt"

    @property
    def system_path(self) -> Path:
        return self.root / "map" / "system.pt"

    @property
    def checkpoint_path(self) -> Path:
        return self.root / "map" / "checkpoint.pt"

    @property
    def curves_path(self) -> Path:
        return self.root / "map" / "curves.json"

    @property
    def mesh_path(self) -> Path:
        return self.root / "mesh.ply"

    @property
    def metrics_path(self) -> Path:
        return self.root / "metrics.json"

    @property
    def snapshots_path(self) -> Path:
        return self.root / "snapshots"

    @property
    def report_path(self) -> Path:
        return self.root / "report.html"

    def color_path(self, name: str) -> Path:
        return self.root / "frames" / "color" / name

    def depth_path(self, sensor: str, index: int) -> Path:
        return self.root / "frames" / "depth" / sensor / f"{index:06d}.png"

    def normal_path(self, sensor: str, index: int) -> Path:
        return self.root / "frames" / "normals" / sensor / f"{index:06d}.png"

    def beta_path(self, sensor: str, index: int) -> Path:
        return self.root / "beta" / sensor / f"{index:06d}.png"

    # --- manifest ----------------------------------------------------------------------------------------------
    @property
    def manifest(self) -> Manifest:
        """Raises RunError if there is no run here, or one of another schema."""
        try:
            raw = json.loads(self.manifest_path.read_text())
        except FileNotFoundError as error:
            raise RunError(
                f"{self.root} holds no run; make one with `uncle preprocess DATASET --run {self.root}`"
            ) from error
        except (OSError, json.JSONDecodeError) as error:
            raise RunError(f"cannot read {self.manifest_path}: {error}") from error
        found = raw.get("schema_version")
        if found != SCHEMA_VERSION:
            raise RunError(
                f"{self.root} was made by another version (schema {found}, here {SCHEMA_VERSION}); "
                "redo it with `uncle preprocess`"
            )
        try:
            return Manifest.model_validate(raw)
        except ValidationError as error:
            raise RunError(
                f"{self.manifest_path} is damaged: {error.errors()[0]['msg']}; redo it with `uncle preprocess`"
            ) from error

    def save_manifest(self, manifest: Manifest) -> None:
        """Raises RunError."""
        write_text(self.manifest_path, manifest.model_dump_json(indent=2) + "\n")

    @property
    def camera(self) -> Camera:
        values = self.manifest.camera
        return Camera(int(values["width"]), int(values["height"]), *(values[key] for key in ("fx", "fy", "cx", "cy")))

    # --- stages ------------------------------------------------------------------------------------------------
    def is_current(self, stage: str, config_hash: str) -> bool:
        """Whether `stage` is finished and was made with this configuration."""
        record = self.manifest.stages.get(stage)
        return record is not None and record.config_hash == config_hash

    def finish_stage(self, stage: str, config_hash: str, started: float, facts: dict[str, Any]) -> None:
        """Record a stage as done; `started` is `time.time()` at its beginning. Raises RunError."""
        manifest = self.manifest
        record = StageRecord(
            config_hash=config_hash,
            finished=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            seconds=round(time.time() - started, 3),
            versions=library_versions(),
            facts=facts,
        )
        manifest.stages = {**manifest.stages, stage: record}
        self.save_manifest(manifest)

    def require_stage(self, stage: str) -> StageRecord:
        """The record of a finished stage. Raises RunError naming the command that makes it."""
        record = self.manifest.stages.get(stage)
        if record is None:
            raise RunError(f"{self.root} has no finished `{stage}` stage; run `uncle {stage} --run {self.root}` first")
        return record


def config_hash(*parts: object) -> str:
    """Short, stable hash of JSON-like settings."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:16]


def library_versions() -> dict[str, str]:
    """Versions that decide a result."""
    found = {"python": platform.python_version()}
    for name in ("uncle", "torch", "open3d", "numpy", "opencv-python-headless"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
