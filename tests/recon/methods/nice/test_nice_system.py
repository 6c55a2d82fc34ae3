"""The paper's system end to end on the box room, with untrained decoders: walls, noise, resuming, tracking."""

from functools import partial

import numpy as np
import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.errors import ConfigError, DataError
from uncle.recon.core.events import Progress
from uncle.recon.core.mesh import Mesh
from uncle.recon.core.mesh_raycaster import Surface
from uncle.recon.core.tensor_files import load_tensors
from uncle.recon.core.trajectory import Trajectory
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.tracking_record import TrackingRecord
from uncle.recon.stages import map as map_stage
from uncle.recon.stages.map import map_run
from uncle.recon.stages.mesh import mesh_run

QUICK = [
    "nice.decoders=random", "nice_mapping.every=4", "nice_mapping.first_iterations=50", "nice_mapping.iterations=12",
    "nice_mapping.pixels=200", "nice_mapping.keyframe_every=4", "nice_mapping.refine=false", "fusion.voxel_size_m=0.08",
    "nice_tracking.pixels=200",
]  # fmt: skip
ANGLES = np.linspace(0, 0.4, 6)


def settings(*overrides: str, method: str = "uncle-paper", sensors=("gt", "noisy"), **top_level):
    return make_config(method, [*QUICK, *overrides], sensors=sensors, device="cpu", **top_level)


def distances(run, room) -> np.ndarray:
    """(V,) metres from the vertices of the run's mesh to the true walls."""
    mesh_run(run, overwrite=True)
    return Surface(room.mesh()).distance(Mesh.load(run.mesh_path).vertices)


@pytest.mark.parametrize("method", ["uncle-paper", "nice-slam"])
def test_the_walls_are_found(make_mappable_run, box_room, method):
    run = make_mappable_run(angles=ANGLES)
    map_run(run, settings(method=method))
    off = distances(run, box_room)
    assert len(off) > 1000
    assert np.median(off) < 0.05
    assert np.quantile(off, 0.9) < 0.2
    assert run.beta_path("noisy", 0).exists() == (method == "uncle-paper")
    learned = load_tensors(run.method_state_path)
    assert learned["scene"]["grids"]["fine"]["table"].shape[1] == 32
    assert list(learned["noise"]) == (["depth/gt", "depth/noisy", "color"] if method == "uncle-paper" else [])
    assert list(learned["keyframes"]) == [0, 4]
    assert run.load_manifest().stages["map"].facts["keyframes"] == 2


class Broken(Exception):
    """Stands for whatever ends a process."""


def results(run) -> list[bytes]:
    mesh_run(run, overwrite=True)
    paths = [run.mesh_path, run.trajectory_path, run.curves_path, *sorted((run.root / "beta").rglob("*.png"))]
    return [path.read_bytes() for path in paths]


@pytest.mark.parametrize("track", [False, True])
def test_broken_run_resumes_to_the_same_bytes(make_mappable_run, monkeypatch, track):
    monkeypatch.setattr(map_stage, "Checkpoint", partial(Checkpoint, interval_s=0.0))
    quick = ["nice_mapping.first_iterations=10", "nice_mapping.iterations=4", "nice_mapping.every=2"]
    if track:  # with so many keyframes that the cameras are adjusted, too
        quick += ["tracking.enabled=true", "nice_tracking.iterations=3"]
        quick += ["nice_mapping.every=1", "nice_mapping.keyframe_every=1"]
    else:
        quick += ["nice_mapping.refine=true"]
    config = settings(*quick, sensors=("noisy",))
    run = make_mappable_run(("noisy",), ANGLES)
    map_run(run, config)
    expected = results(run)

    def stop(event):
        if isinstance(event, Progress) and event.stage.endswith("mapping") and event.done == 4:
            raise Broken

    with pytest.raises(Broken):
        map_run(run, config, overwrite=True, on_event=stop)
    map_run(run, config, resume=True)
    same = results(run) == expected  # megabytes: pytest would take minutes to say where they differ
    assert same


def test_tracking_follows_a_small_motion(make_mappable_run):
    run = make_mappable_run(("gt",), np.linspace(0, 0.08, 4))
    map_run(run, settings("tracking.enabled=true", "tracking.color=false", "nice_tracking.iterations=15",
                          "nice_mapping.first_iterations=70", sensors=("gt",)))  # fmt: skip
    found = Trajectory.load(run.trajectory_path).T_world_camera
    true = Trajectory.load(run.reference_trajectory_path).T_world_camera
    stayed = np.linalg.norm(true[-1, :3, 2] - true[0, :3, 2])
    assert np.linalg.norm(found[-1, :3, 2] - true[-1, :3, 2]) < 0.35 * stayed
    assert TrackingRecord.load(run.tracking_path).counts()["tracked"] == 4


def test_a_bound_can_be_set(make_mappable_run):
    run = make_mappable_run(("gt",), ANGLES)
    map_run(run, settings("nice.bound=[-0.2, 4.2, -0.2, 3.2, -0.2, 2.7]", "nice_mapping.first_iterations=2",
                          "nice_mapping.iterations=2", sensors=("gt",)))  # fmt: skip
    bound = load_tensors(run.method_state_path)["scene"]["bound"]
    torch.testing.assert_close(bound, torch.tensor([[-0.2, -0.2, -0.2], [4.28, 3.32, 3.0]]))


def test_what_does_not_fit_is_said(make_mappable_run):
    run = make_mappable_run(("gt",), ANGLES)
    with pytest.raises(ConfigError, match=r"nice\.bound"):
        map_run(run, settings("nice.bound=[0, 1, 2]", sensors=("gt",)))
    with pytest.raises(ConfigError, match="no file"):
        map_run(run, settings("nice.decoders=nowhere.pt", sensors=("gt",)))
    with pytest.raises(DataError, match="no frame could be mapped"):
        map_run(run, settings("fusion.max_depth_m=0.2", sensors=("gt",)))
