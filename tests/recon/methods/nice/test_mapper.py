"""The mapper on views of the box room: bundle adjustment, refinement, what may change and what may not."""

import numpy as np
import pytest
import torch
from uncle.recon.core.config.map_config import make_config
from uncle.recon.core.frame import Frame
from uncle.recon.core.se3 import apply_motion
from uncle.recon.methods.nice.system import NiceSystem

QUICK = [
    "nice.decoders=random", "nice_mapping.first_iterations=4", "nice_mapping.iterations=6", "nice_mapping.pixels=60",
    "nice_mapping.keyframe_every=1", "nice_mapping.window=8", "nice.bound=[-0.5, 4.5, -0.5, 3.5, -0.5, 3.0]",
]  # fmt: skip


class RoomFrames:
    """As much of a run as the system asks for; the colours are those of the painted walls."""

    sensors = ("gt",)

    def __init__(self, room, poses):
        self.room, self.camera, self.poses = room, room.camera, poses

    def __getitem__(self, index: int) -> Frame:
        pose = self.poses[index]
        depth = torch.from_numpy(self.room.depth(pose)).float()
        return Frame(index, float(index), torch.from_numpy(self.room.picture(pose)), {"gt": depth}, pose)

    def normals(self, index: int, sensor: str) -> torch.Tensor:
        return torch.from_numpy(self.room.normals(self.poses[index]))


@pytest.fixture
def frames(box_room):
    return RoomFrames(box_room, [box_room.pose(angle) for angle in np.linspace(0, 0.3, 7)])


def make_system(frames, *overrides: str, track: bool = True) -> NiceSystem:
    settings = [*QUICK, f"tracking.enabled={str(track).lower()}", *overrides]
    system = NiceSystem(
        frames, make_config("uncle-paper", settings, sensors=("gt",), device="cpu"), torch.device("cpu")
    )
    system.begin(list(range(len(frames.poses))), lambda event: None)
    return system


def map_all(system: NiceSystem, frames, indices, last: int | None = None) -> list[dict[int, np.ndarray]]:
    found = []
    for index in indices:
        frame = frames[index]
        pose = apply_motion(frame.T_world_camera, np.array([0.02, 0, 0, 0, 0, 0]) * (index == 5))
        found.append(system.map(frame, system.prepare(frame), pose, index == last))
    return found


@pytest.mark.parametrize("color", ["true", "false"])
def test_cameras_are_adjusted_when_there_are_more_than_four_keyframes(frames, color):
    system = make_system(frames, f"nice.color={color}")
    moves = map_all(system, frames, range(6))
    assert moves[:5] == [{}] * 5
    assert 5 in moves[5]
    assert len(moves[5]) == 6  # five keyframes, all seen, and the current frame
    np.testing.assert_allclose(moves[5][0], frames.poses[0], atol=1e-6)  # the oldest one is held
    offsets = [np.abs(moves[5][i] - frames.poses[i]).max() for i in range(1, 5)]
    assert all(1e-5 < offset < 0.01 for offset in offsets)
    np.testing.assert_array_equal(system.mapper.keyframes[3].T_world_camera, moves[5][3])


def test_given_poses_are_never_moved(frames):
    assert map_all(make_system(frames, track=False), frames, range(6)) == [{}] * 6


def test_features_out_of_view_stay_and_those_in_view_change(frames):
    system = make_system(frames, track=False)
    before = {name: grid.table.detach().clone() for name, grid in system.scene.grids.items()}
    map_all(system, frames, [0])
    pose = torch.from_numpy(frames.poses[0]).float()
    for name, grid in system.scene.grids.items():
        changed = (grid.table.detach() != before[name]).any(1)
        behind = (grid.vertices() - pose[:3, 3]) @ pose[:3, 2] < -0.6
        assert changed.any(), name
        assert not changed[behind].any(), name


def test_the_last_frame_refines_everything_but_the_colour_decoder(frames):
    system = make_system(frames, track=False)
    plain = make_system(frames, "nice_mapping.refine=false", track=False)
    steps, loss = [], system.mapper.loss
    system.mapper.loss = lambda window, poses, stage: steps.append((window.count, stage)) or loss(window, poses, stage)
    map_all(system, frames, [0, 1], last=1)
    map_all(plain, frames, [0, 1], last=1)
    refinement = steps[4 + 6 :]  # after the steps of both frames
    assert len(refinement) == 5 * 6
    assert {stage for _, stage in refinement} == {"color"}
    decoders = [mapped.scene.color_decoder.parameters() for mapped in (system, plain)]
    assert all(torch.equal(a, b) for a, b in zip(*decoders, strict=True))
    tables = [mapped.scene.grids["fine"].table for mapped in (system, plain)]
    assert not torch.equal(*tables)


def test_the_box_grows_when_a_camera_sees_beyond_it(frames, box_room):
    system = make_system(frames, "nice.bound=[]")
    map_all(system, frames, [0])
    bound, grid = system.scene.bound.clone(), system.scene.grids["fine"]
    system.extend_bound(system.prepare(frames[0]), frames.poses[0])
    assert torch.equal(system.scene.bound, bound)
    turned = box_room.pose(np.pi)
    system.extend_bound(system.prepare(frames[0]), turned)
    assert system.scene.bound[0, 0] < bound[0, 0]
    points = bound[0] + torch.rand(50, 3) * (bound[1] - bound[0])
    torch.testing.assert_close(system.scene.grids["fine"].lookup(points), grid.lookup(points), atol=1e-5, rtol=1e-5)
