"""The run directory: every path, the manifest, and which stages are done."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..core.camera import Camera
from ..core.errors import RunError
from ..core.files import write_text
from .manifest import SCHEMA_VERSION, Manifest, StageRecord, library_versions


class RunDirectory:
    """Paths and manifest of one run. Reading never changes the folder; every `load_` reads the file again."""

    def __init__(self, root: Path) -> None:
        self.root = Path(root)

    # --- paths -------------------------------------------------------------------------------------------------
    @property
    def manifest_path(self) -> Path:
        """Facts of the run and of its finished stages."""
        return self.root / "manifest.json"

    @property
    def frames_path(self) -> Path:
        """Source, time, pose and images of each frame."""
        return self.root / "frames" / "frames.json"

    @property
    def config_path(self) -> Path:
        """All settings of the map."""
        return self.root / "config.toml"

    @property
    def trajectory_path(self) -> Path:
        """Estimated poses, in the TUM format."""
        return self.root / "trajectory.txt"

    @property
    def reference_trajectory_path(self) -> Path:
        """Poses of the data set, in the TUM format; missing where it has none."""
        return self.root / "trajectory_gt.txt"

    @property
    def tracking_path(self) -> Path:
        """Status and covariance of each tracked frame; missing where poses were given."""
        return self.root / "tracking.json"

    @property
    def sensors_path(self) -> Path:
        """Faults of each sensor."""
        return self.root / "sensors.json"

    @property
    def field_path(self) -> Path:
        """The finished map."""
        return self.root / "map" / "field.pt"

    @property
    def noise_model_path(self) -> Path:
        """Noise models of the mapped sensors."""
        return self.root / "map" / "noise_model.pt"

    @property
    def method_state_path(self) -> Path:
        """What a method keeps beside the map."""
        return self.root / "map" / "method_state.pt"

    @property
    def checkpoint_path(self) -> Path:
        """State of an interrupted map."""
        return self.root / "map" / "checkpoint.pt"

    @property
    def curves_path(self) -> Path:
        """Losses of the training, by step."""
        return self.root / "map" / "curves.json"

    @property
    def mesh_path(self) -> Path:
        """Coloured mesh with a sigma per vertex."""
        return self.root / "mesh.ply"

    @property
    def metrics_path(self) -> Path:
        """All scores."""
        return self.root / "metrics.json"

    @property
    def snapshots_path(self) -> Path:
        """Folder of the pictures."""
        return self.root / "snapshots"

    @property
    def report_path(self) -> Path:
        """The report."""
        return self.root / "report.html"

    def color_path(self, name: str) -> Path:
        """Colour image by the name that its frame record has."""
        return self.root / "frames" / "color" / name

    def depth_path(self, sensor: str, index: int) -> Path:
        """Depth image, 16-bit PNG."""
        return self.root / "frames" / "depth" / sensor / f"{index:06d}.png"

    def normal_path(self, sensor: str, index: int) -> Path:
        """Image of the normals (`frames.encode_normals`)."""
        return self.root / "frames" / "normals" / sensor / f"{index:06d}.png"

    def beta_path(self, sensor: str, index: int) -> Path:
        """Image of the Laplace scale, 16-bit PNG."""
        return self.root / "beta" / sensor / f"{index:06d}.png"

    # --- manifest ----------------------------------------------------------------------------------------------
    def load_manifest(self) -> Manifest:
        """Read `manifest.json`. Raises RunError if there is no run here, or one of another schema."""
        try:
            content = json.loads(self.manifest_path.read_text())
        except FileNotFoundError as error:
            raise RunError(
                f"{self.root} holds no run; make one with `uncle preprocess DATASET --run {self.root}`"
            ) from error
        except (OSError, json.JSONDecodeError) as error:
            raise RunError(f"cannot read {self.manifest_path}: {error}") from error
        redo = f"redo it with `uncle preprocess {_dataset_of(content)} --overwrite --run {self.root}`"
        schema = content.get("schema_version") if isinstance(content, dict) else None
        if schema != SCHEMA_VERSION:
            raise RunError(
                f"{self.root} was made by another version of uncle (schema {schema}, here {SCHEMA_VERSION}); {redo}"
            )
        try:
            return Manifest.model_validate(content)
        except ValidationError as error:
            raise RunError(f"{self.manifest_path} is damaged: {error.errors()[0]['msg']}; {redo}") from error

    def require(self) -> None:
        """Raises RunError if this is no run directory, or one of another version."""
        self.load_manifest()

    def save_manifest(self, manifest: Manifest) -> None:
        """Raises RunError."""
        write_text(self.manifest_path, manifest.model_dump_json(indent=2) + "\n")

    def load_camera(self) -> Camera:
        """The camera that all images of the run share. Raises RunError."""
        return self.load_manifest().pinhole_camera()

    # --- stages ------------------------------------------------------------------------------------------------
    def is_current(self, stage: str, config_hash: str) -> bool:
        """Whether `stage` is finished and was made with this configuration."""
        record = self.load_manifest().stages.get(stage)
        return record is not None and record.config_hash == config_hash

    def finish_stage(self, stage: str, config_hash: str, started: float, facts: dict[str, Any]) -> None:
        """Record a stage as done; `started` is `time.time()` at its beginning. Raises RunError."""
        manifest = self.load_manifest()
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
        record = self.load_manifest().stages.get(stage)
        if record is None:
            raise RunError(f"{self.root} has no finished `{stage}` stage; run `uncle {stage} --run {self.root}` first")
        return record


def _dataset_of(content: Any) -> str:
    """The data set that a manifest of any version names, else a placeholder."""
    dataset = content.get("dataset") if isinstance(content, dict) else None
    return dataset if isinstance(dataset, str) else "DATASET"
