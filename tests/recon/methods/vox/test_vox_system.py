"""The whole method on a room whose walls are known."""

import numpy as np
import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.events import Progress
from uncle.recon.methods.online import map_online
from uncle.recon.methods.vox.system import VoxSystem
from uncle.recon.run.checkpoint import Checkpoint
from uncle.recon.run.frames import RunFrames
from uncle.recon.stages.map import load_field, map_run
from uncle.recon.volume.mesh_extraction import make_mesh

ROOM_M = np.array([4.0, 3.0, 2.5])
SMALL = [
    "vox.hidden=48", "vox.features=16", "vox.rays=256", "vox.first_iterations=60", "vox.iterations=12",
    "vox.step_voxels=0.1", "vox.keyframe_every=1", "vox.window=3", "fusion.voxel_size_m=0.04",
]  # fmt: skip


def distance_to_walls(points: np.ndarray) -> np.ndarray:
    """(V, 3) points in the room or near its walls -> (V,) metres to the nearest wall."""
    return np.minimum(np.abs(points), np.abs(points - ROOM_M)).min(1)


@pytest.fixture
def room(make_mappable_run):
    return make_mappable_run(("gt", "noisy"))


def test_the_walls_are_where_they_are(room, box_room):
    config = make_config("vox-fusion", SMALL, sensors=("gt",), device="cpu")
    summary = map_run(room, config)
    assert summary.frames == 12
    field = load_field(room)
    poses = [box_room.pose(angle) for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
    mesh = make_mesh(field, box_room.camera, poses)
    assert len(mesh.vertices) > 2000
    error = distance_to_walls(mesh.vertices)
    assert np.median(error) < 0.005
    assert (error < 0.02).mean() > 0.97
    colors = np.median(mesh.colors, axis=0)
    assert np.abs(colors - [200, 120, 60]).max() < 25
    learned = torch.load(room.method_state_path, weights_only=True)
    assert learned["embeddings"].shape == (len(learned["corners"]), 16)
    assert len(learned["losses"]) == 12
    assert learned["losses"][-1] < learned["losses"][0] / 2


def test_two_sensors_share_the_map(room):
    """The voxels of both are made, and both take part in the loss."""
    config = make_config("vox-fusion", [*SMALL, "vox.first_iterations=1"], sensors=("gt", "noisy"), device="cpu")
    frames = RunFrames(room, ("gt", "noisy"))
    both = VoxSystem(frames, config, torch.device("cpu"))
    view = both.prepare(frames[0])
    assert (view.depths > 0).float().mean(0).tolist() == [1, 1]
    both.map(frames[0], view, frames.pose(0), last=False)
    alone = VoxSystem(RunFrames(room, ("gt",)), config, torch.device("cpu"))
    alone.map(frames[0], alone.prepare(alone.frames[0]), frames.pose(0), last=False)
    assert len(both.model.voxels) > len(alone.model.voxels)


def test_bfloat16_changes_little(room):
    """The same rays, the same start: losses and distances are alike, not equal."""
    frames = RunFrames(room, ("gt",))
    made = []
    for wanted in ("false", "true"):
        settings = [*SMALL, "vox.first_iterations=30", f"vox.bfloat16={wanted}"]
        config = make_config("vox-fusion", settings, sensors=("gt",), device="cpu")
        system = VoxSystem(frames, config, torch.device("cpu"))
        system.map(frames[0], system.prepare(frames[0]), frames.pose(0), last=False)
        made.append((system.mapper.losses[0], system.field({0: frames.pose(0)}, lambda _: None).base[:, 0]))
    assert made[1][0] != made[0][0]
    assert made[1][0] == pytest.approx(made[0][0], rel=0.02)
    assert float((made[1][1] - made[0][1]).abs().median()) < 2e-3


def test_a_camera_is_found_again(box_room, make_mappable_run):
    """From a pose that is 5 cm and 2 degrees off, against a map of the frame itself."""
    run = make_mappable_run(("gt",), angles=np.array([0.6, 0.9]))
    settings = [*SMALL, "vox.first_iterations=120", "vox.tracking_iterations=60", "vox.tracking_rays=256"]
    config = make_config("vox-fusion", settings, sensors=("gt",), device="cpu")
    frames = RunFrames(run, ("gt",))
    system = VoxSystem(frames, config, torch.device("cpu"))
    for index in (0, 1):
        system.map(frames[index], system.prepare(frames[index]), frames.pose(index), last=False)
    off = np.eye(4)
    off[:3, 3] = [0.03, -0.02, 0.03]
    off[:3, :3] = [[np.cos(0.035), 0, np.sin(0.035)], [0, 1, 0], [-np.sin(0.035), 0, np.cos(0.035)]]
    learned = system.model.embeddings.clone()
    found = system.track(frames[0], system.prepare(frames[0]), [frames.pose(0) @ off])
    error = np.linalg.inv(frames.pose(0)) @ found.T_world_camera
    assert found.status == "tracked"
    assert np.linalg.norm(error[:3, 3]) < 0.005
    assert np.arccos((np.trace(error[:3, :3]) - 1) / 2) < 0.01
    assert torch.equal(system.model.embeddings, learned)


def test_a_frame_without_readings_is_lost(room):
    frames = RunFrames(room, ("gt",))
    system = VoxSystem(frames, make_config("vox-fusion", SMALL, sensors=("gt",), device="cpu"), torch.device("cpu"))
    frame = frames[0]
    frame.depths["gt"].zero_()
    found = system.track(frame, system.prepare(frame), [np.eye(4)])
    assert found.status == "lost"
    assert found.T_world_camera is None


def test_frames_without_readings_leave_no_trace(room):
    """A first frame without any does not use up the steps of the first; no frame with any makes no surface."""
    config = make_config("vox-fusion", SMALL, sensors=("gt",), device="cpu")
    frames = RunFrames(room, ("gt",))
    system = VoxSystem(frames, config, torch.device("cpu"))
    frame = frames[0]
    frame.depths["gt"].zero_()
    system.map(frame, system.prepare(frame), frames.pose(0), last=False)
    assert system.keyframes() == 0
    assert not system.mapper.losses
    assert not system.field({0: frames.pose(0)}, lambda _: None).known.any()


def test_a_broken_run_goes_on_to_the_same_result(room, tmp_path):
    """Tracked, so that poses, rays and moments of Adam all have to be there again."""
    settings = [*SMALL, "vox.rays=64", "vox.first_iterations=10", "vox.iterations=3", "vox.tracking_iterations=3",
                "vox.tracking_rays=64", "tracking.enabled=true"]  # fmt: skip
    config = make_config("vox-fusion", settings, sensors=("noisy",), device="cpu")
    frames = RunFrames(room, ("noisy",))

    class Broken(Exception):
        pass

    def run(checkpoint, stop_at=None):
        def listen(event):
            if isinstance(event, Progress) and event.done == stop_at:
                raise Broken

        system = VoxSystem(frames, config, torch.device("cpu"))
        made = map_online(frames, list(range(6)), config, system, checkpoint, lambda *_: None, listen)
        return made, system.artifacts()

    whole, learned = run(Checkpoint(tmp_path / "whole.pt", "", 0.0))
    broken = Checkpoint(tmp_path / "broken.pt", "", 0.0)
    with pytest.raises(Broken):
        run(broken, stop_at=4)
    again, relearned = run(broken)
    assert torch.equal(again.field.base, whole.field.base)
    assert torch.equal(learned["embeddings"], relearned["embeddings"])
    assert learned["losses"] == relearned["losses"]
    for index, pose in whole.poses.items():
        np.testing.assert_array_equal(again.poses[index], pose)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_a_gpu_makes_the_same_map(room):
    """Other random numbers, the same walls; tracking starts at the right pose and stays there."""
    config = make_config("vox-fusion", SMALL, sensors=("gt",), device="cuda")
    frames = RunFrames(room, ("gt",))
    system = VoxSystem(frames, config, torch.device("cuda"))
    for index in range(3):
        system.map(frames[index], system.prepare(frames[index]), frames.pose(index), last=False)
    found = system.track(frames[2], system.prepare(frames[2]), [frames.pose(2)])
    assert np.linalg.norm(found.T_world_camera[:3, 3] - frames.pose(2)[:3, 3]) < 0.05
    field = system.field({index: frames.pose(index) for index in range(3)}, lambda _: None)
    near = field.known & (field.base[:, 0].abs() < 0.01)
    rows = near.nonzero()[:, 0]
    grid = field.grid
    points = (grid.blocks[rows // 512] * grid.block_size_m + grid.inner_offsets()[rows % 512]).cpu().numpy()
    assert len(points) > 200
    assert np.median(distance_to_walls(points)) < 0.03
