"""The run directory: every path, the manifest, and which stages are done."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..core.camera import Camera
from ..core.errors import RunError
from ..core.files import read_json, write_text
from ..core.json_values import first_problem
from ..core.trajectory import Trajectory
from .manifest import SCHEMA_VERSION, Manifest, StageRecord, config_hash, library_versions

# stage -> the stages that are made from it
MADE_FROM = {"preprocess": ("map", "mesh", "eval"), "map": ("mesh", "eval"), "mesh": ("eval",), "eval": ()}
_RESULT = {"preprocess": "the frames", "map": "the map", "mesh": "the mesh", "eval": "the metrics"}


class RunDirectory:
    """Paths and manifest of one run. Reading never changes the folder; every `load_` reads the file again.

    waits   a stage that would write into the run while another process does waits for it, instead of raising
    """

    def __init__(self, root: Path, waits: bool = False) -> None:
        self.root, self.waits = Path(root), waits

    # --- paths -------------------------------------------------------------------------------------------------
    @property
    def manifest_path(self) -> Path:
        """Facts of the run and of its finished stages."""
        return self.root / "manifest.json"

    @property
    def lock_path(self) -> Path:
        """Who writes into the run at the moment (`lock.py`)."""
        return self.root / ".lock"

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
            content = read_json(self.manifest_path)
        except FileNotFoundError as error:
            raise RunError(
                f"{self.root} holds no run; make one with `uncle preprocess DATASET --run {self.root}`"
            ) from error
        except (OSError, ValueError) as error:
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
            raise RunError(f"{self.manifest_path} is damaged: {first_problem(error)}; {redo}") from error

    def require(self) -> None:
        """Raises RunError if this is no run directory, or one of another version."""
        self.load_manifest()

    def save_manifest(self, manifest: Manifest) -> None:
        """Raises RunError."""
        write_text(self.manifest_path, manifest.model_dump_json(indent=2) + "\n")

    def load_camera(self) -> Camera:
        """The camera that all images of the run share. Raises RunError."""
        return self.load_manifest().pinhole_camera()

    def load_trajectory(self, path: Path | None = None) -> Trajectory:
        """`trajectory.txt`, or another file, relative to the world offset of the run. Raises DataError, RunError."""
        x, y, z = self.load_manifest().world_offset_m
        return Trajectory.load(path or self.trajectory_path).moved((-x, -y, -z))

    # --- stages ------------------------------------------------------------------------------------------------
    def is_current(self, stage: str, config_hash: str) -> bool:
        """Whether `stage` is finished, and was made with this configuration from the present results before it."""
        manifest = self.load_manifest()
        record = manifest.stages.get(stage)
        return record is not None and record.config_hash == config_hash and not _outdated(manifest, stage)

    def begin_stage(self, stage: str, manifest: Manifest | None = None) -> None:
        """Mark the results of `stage` and all that was made from them as outdated, before the first of its files is
        written: after an interruption nothing passes for the result of something else. A `manifest` replaces the
        earlier one. Raises RunError.
        """
        manifest = manifest or self.load_manifest()
        reasons = {stage: f"`uncle {stage}` has not finished writing"}
        reasons |= dict.fromkeys(MADE_FROM[stage], f"made from earlier {_RESULT[stage].removeprefix('the ')}")
        existing = {name for name in reasons if name in manifest.stages or self._result_path(name).exists()}
        manifest.stages = {name: record for name, record in manifest.stages.items() if name not in reasons}
        manifest.outdated = manifest.outdated | {name: reasons[name] for name in reasons if name in existing | {stage}}
        self.save_manifest(manifest)

    def finish_stage(
        self, stage: str, config_hash: str, started: float, facts: dict[str, Any], inputs: Sequence[str] = (),
        output: str | None = None,
    ) -> None:  # fmt: skip
        """Record a stage as done.

        started   `time.time()` at its beginning
        inputs    stages whose results it was made from; those that do not exist are left out
        output    digest of what was made; None: one that no other result has

        Raises RunError.
        """
        manifest = self.load_manifest()
        record = StageRecord(
            config_hash=config_hash,
            output=output or _unique_digest(stage, config_hash),
            inputs={name: manifest.stages[name].output for name in inputs if name in manifest.stages},
            finished=time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
            seconds=round(time.time() - started, 3),
            versions=library_versions(),
            facts=facts,
        )
        manifest.stages = {**manifest.stages, stage: record}
        manifest.outdated = {name: reason for name, reason in manifest.outdated.items() if name != stage}
        self.save_manifest(manifest)

    def require_stage(self, stage: str) -> StageRecord:
        """The record of a finished stage. Raises RunError naming the command that makes it, or makes it again."""
        self.require_current(stage)
        manifest = self.load_manifest()
        record = manifest.stages.get(stage)
        if record is None:
            command = _command(self.root, manifest, stage)
            raise RunError(f"{self.root} has no finished `{stage}` stage; run `{command}` first")
        return record

    def require_current(self, *stages: str) -> None:
        """Raises RunError if a result of `stages` is not one of the present frames, or was not finished.

        Stages without a result pass.
        """
        manifest = self.load_manifest()
        for stage in stages:
            if reason := _outdated(manifest, stage):
                command = _command(self.root, manifest, stage)
                raise RunError(f"{_RESULT[stage]} of {self.root} cannot be used: {reason}; redo with `{command}`")

    def _result_path(self, stage: str) -> Path:
        """A file that exists if the stage ever wrote a result."""
        paths = {"preprocess": self.frames_path, "map": self.field_path, "mesh": self.mesh_path}
        return paths.get(stage, self.metrics_path)


def _outdated(manifest: Manifest, stage: str) -> str:
    """Why the result of a stage is not one of the present frames; empty if it is, or does not exist."""
    if stage in manifest.outdated:
        return manifest.outdated[stage]
    record = manifest.stages.get(stage)
    for name, digest in record.inputs.items() if record is not None else ():
        source = manifest.stages.get(name)
        if source is None or source.output != digest:
            return f"made from other {_RESULT[name].removeprefix('the ')}"
        if reason := _outdated(manifest, name):
            return reason
    return ""


def _command(root: Path, manifest: Manifest, stage: str) -> str:
    """The command line that makes the result of a stage."""
    return (
        f"uncle preprocess {manifest.dataset} --run {root}" if stage == "preprocess" else f"uncle {stage} --run {root}"
    )


def _unique_digest(*parts: object) -> str:
    return config_hash(*parts, time.time_ns(), os.getpid())


def _dataset_of(content: Any) -> str:
    """The data set that a manifest of any version names, else a placeholder."""
    dataset = content.get("dataset") if isinstance(content, dict) else None
    return dataset if isinstance(dataset, str) else "DATASET"
