"""Stages on a run that another process writes into, or whose frames are no longer those of its map."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.errors import RunError
from uncle.recon.core.mesh import Mesh
from uncle.recon.methods.registry import method_spec
from uncle.recon.run.directory import RunDirectory
from uncle.recon.run.lock import writing
from uncle.recon.stages.evaluate import evaluate_run
from uncle.recon.stages.map import map_run
from uncle.recon.stages.mesh import mesh_run
from uncle.recon.stages.preprocess import preprocess_run
from uncle.recon.stages.report import report_run
from uncle.recon.stages.snapshot import snapshot_run
from uncle.recon.stages.uncertainty import uncertainty_run


@dataclass
class PlaneRecording:
    """A camera that moves in front of a plane; frame `empty` has no depth."""

    count: int = 6
    empty: int = -1
    sensors: tuple[str, ...] = ("depth",)
    name: str = "plane"
    format: str = "memory"
    camera: Camera = field(default_factory=lambda: Camera(48, 36, 40.0, 40.0, 23.5, 17.5))
    has_poses: bool = True
    has_timestamps: bool = False
    reference_mesh: Path | None = None
    registration_sigma_px: float = 0.0
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return self.count

    def timestamp(self, index: int) -> float:
        return float(index)

    def pose(self, index: int) -> np.ndarray:
        pose = np.eye(4)
        pose[0, 3] = 0.1 * index
        return pose

    def color(self, index: int) -> torch.Tensor:
        return torch.full((36, 48, 3), 10 * index, dtype=torch.uint8)

    def depth(self, index: int, sensor: str) -> torch.Tensor:
        return torch.full((36, 48), 0.0 if index == self.empty else 1.0)


def preprocess(run: RunDirectory, dataset: Path, **recording) -> None:
    preprocess_run(PlaneRecording(**recording), run, dataset=dataset, overwrite=True)


def map_quickly(run: RunDirectory) -> None:
    config = method_spec("tsdf").configure(["fusion.voxel_size_m=0.1", "fusion.min_observations=1"], device="cpu")
    map_run(run, config)


STAGES = {
    "map": map_quickly,
    "mesh": mesh_run,
    "eval": evaluate_run,
    "uncertainty": lambda run: uncertainty_run(run, run.snapshots_path),
    "snapshot": lambda run: snapshot_run(run, run.snapshots_path),
    "report": lambda run: report_run(run, "raycast"),
}


@pytest.fixture
def run(tmp_path):
    run, folder = RunDirectory(tmp_path / "run"), tmp_path / "data"
    folder.mkdir()
    preprocess(run, folder)
    map_quickly(run)
    mesh_run(run)
    return run


def files_of(run: RunDirectory) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in run.root.rglob("*") if path.is_file() and path != run.lock_path}


def test_no_stage_writes_into_a_run_that_another_one_owns(run, tmp_path):
    before = files_of(run)
    with writing(run, "map"):
        for stage, start in STAGES.items():
            with pytest.raises(RunError, match=r"in use by `uncle map`"):
                start(run)
            assert files_of(run) == before, stage
        with pytest.raises(RunError, match=r"in use by `uncle map`"):
            preprocess(run, tmp_path / "data", count=4)
        assert files_of(run) == before


def test_a_mesh_can_be_written_elsewhere_meanwhile(run, tmp_path):
    with writing(run, "map"):
        mesh_run(run, out=tmp_path / "mesh.ply")
    np.testing.assert_array_equal(Mesh.load(tmp_path / "mesh.ply").vertices, Mesh.load(run.mesh_path).vertices)


@pytest.mark.parametrize("stage", ["mesh", "eval", "uncertainty", "snapshot", "report"])
def test_what_was_made_from_other_frames_is_not_passed_on(run, tmp_path, stage):
    preprocess(run, tmp_path / "data", count=4)
    with pytest.raises(RunError, match=r"the map of .* made from earlier frames; redo with `uncle map --run") as caught:
        STAGES[stage](run)
    assert "\n" not in str(caught.value)


def test_the_same_files_with_other_content_are_other_frames(run, tmp_path):
    """The digest is one of the images, not of names, sizes and times of the files of the data set."""
    digests = [run.load_manifest().stages["preprocess"].output]
    for empty in (-1, 5):
        preprocess(run, tmp_path / "data", empty=empty)
        digests.append(run.load_manifest().stages["preprocess"].output)
    assert digests[0] == digests[1] != digests[2]


def test_a_map_that_is_made_again_makes_the_mesh_outdated(run, tmp_path):
    preprocess(run, tmp_path / "data")
    map_quickly(run)
    with pytest.raises(RunError, match=r"the mesh of .*redo with `uncle mesh --run"):
        evaluate_run(run)
    mesh_run(run)
    evaluate_run(run)
    assert list(run.load_manifest().stages) == ["preprocess", "map", "mesh", "eval"]
