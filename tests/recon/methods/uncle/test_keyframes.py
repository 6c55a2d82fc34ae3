"""Selection of keyframes, and the buffer of their pixels."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from uncle.recon.core.camera import Camera
from uncle.recon.core.config.uncle import KeyframeConfig
from uncle.recon.core.frame import Frame
from uncle.recon.methods.uncle.keyframes import KeyframeSelector, mean_depth
from uncle.recon.methods.uncle.ray_buffer import RayBuffer, Rays


@pytest.fixture
def chosen(box_room):
    """Whether each of the frames seen along the given angles becomes a keyframe."""

    def choose(angles, config: KeyframeConfig | None = None) -> list[bool]:
        selector = KeyframeSelector(box_room.camera, config or KeyframeConfig())
        decisions = []
        for index, angle in enumerate(angles):
            pose = box_room.pose(angle)
            depth = torch.from_numpy(box_room.depth(pose)).float()
            frame = Frame(index, index, torch.zeros(120, 160, 3, dtype=torch.uint8), {"gt": depth}, pose)
            decisions.append(selector.is_keyframe(frame, torch.from_numpy(pose).float()))
        return decisions

    return choose


def test_a_camera_that_stays_gives_one(chosen):
    assert chosen([0.7] * 20) == [True] + [False] * 19


def test_a_camera_that_turns_gives_more_and_none_on_its_second_round(chosen):
    angles = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    first, second = chosen(angles), chosen(np.tile(angles, 2))[120:]
    assert 20 <= sum(first) <= 80
    assert sum(second) == 0
    few = chosen(angles, KeyframeConfig(max_overlap=0.5))
    assert 3 <= sum(few) < sum(first)


def test_frames_without_measurements_add_nothing(box_room):
    selector = KeyframeSelector(box_room.camera, KeyframeConfig())
    empty = Frame(0, 0, torch.zeros(120, 160, 3, dtype=torch.uint8), {"a": torch.zeros(120, 160)}, np.eye(4))
    assert sum(selector.is_keyframe(empty, torch.eye(4)) for _ in range(3)) <= 1


def test_mean_depth_is_over_the_sensors_that_measured():
    depths = {"a": torch.tensor([[1.0, 0.0, 0.0]]), "b": torch.tensor([[3.0, 2.0, 0.0]])}
    frame = Frame(0, 0, torch.zeros(1, 3, 3, dtype=torch.uint8), depths, None)
    torch.testing.assert_close(mean_depth(frame), torch.tensor([[2.0, 2.0, 0.0]]))


SENSORS = ("a", "b")


def make_rays(first: int, count: int) -> Rays:
    """Rays each of whose columns holds their number."""
    number = torch.arange(first, first + count).float()[:, None]
    return Rays(
        SENSORS, frames=torch.full((count,), first // 100), origins=number.expand(-1, 3),
        directions=-number.expand(-1, 3), depths=number.expand(-1, 2),
        colors=(number.expand(-1, 3) % 256).byte(), inputs=(number[..., None] % 100).expand(-1, 2, 4).half(),
    )  # fmt: skip


def empty_buffer(capacity: int = 1000) -> RayBuffer:
    return RayBuffer(Camera(8, 6, 8.0, 8.0, 3.5, 2.5), SENSORS, KeyframeConfig(max_rays=capacity), 5.0)


def filled(seed: int, keyframes: int = 30) -> RayBuffer:
    buffer, generator = empty_buffer(), torch.Generator().manual_seed(seed)
    for index in range(keyframes):
        buffer.add(make_rays(index * 100, 100), generator)
    return buffer


def test_buffer_is_bounded_and_keeps_rays_whole():
    buffer = filled(0)
    assert len(buffer) == 1000
    rays = buffer.rays
    number = rays.depths[:, 0]
    assert torch.equal(rays.origins[:, 1], number)
    assert torch.equal(rays.directions[:, 2], -number)
    assert torch.equal(rays.colors[:, 0].float(), number % 256)
    assert torch.equal(rays.inputs[:, 1, 3].float(), number % 100)
    assert len(number.unique()) == 1000


def test_buffer_keeps_old_and_new_keyframes():
    keyframe = (filled(0).rays.depths[:, 0] / 100).floor()
    assert (keyframe < 10).sum() > 20
    assert (keyframe >= 20).sum() > 300


def test_buffer_is_seeded():
    assert torch.equal(filled(1).rays.depths, filled(1).rays.depths)
    assert not torch.equal(filled(1).rays.depths, filled(2).rays.depths)
    assert len(empty_buffer()) == 0


def test_rays_are_drawn_by_the_names_of_the_sensors():
    """The order of the images of a frame does not matter; only pixels that some sensor measured are drawn."""
    buffer, generator = empty_buffer(), torch.Generator().manual_seed(0)
    first, second = torch.zeros(6, 8), torch.zeros(6, 8)
    first[2], second[3] = 1.0, 2.0
    color = torch.arange(144, dtype=torch.uint8).view(6, 8, 3)
    inputs = {"b": torch.full((6, 8, 3), 2.0), "a": torch.full((6, 8, 3), 1.0)}
    frame = Frame(7, 7, color, {"b": second, "a": first}, None)
    rays = buffer.draw(frame, inputs, torch.eye(4), generator)
    assert rays.frames.unique().tolist() == [7]
    depth, seen = rays.measured_by("a")
    assert set(depth.tolist()) == {0.0, 1.0}
    assert seen.unique().tolist() == [1.0]
    depth, seen = rays.measured_by("b")
    assert set(depth.tolist()) == {0.0, 2.0}
    assert seen.unique().tolist() == [2.0]
    assert ((rays.depths > 0).sum(1) == 1).all()
    nothing = Frame(8, 8, color, {"a": torch.zeros(6, 8), "b": torch.zeros(6, 8)}, None)
    assert len(buffer.draw(nothing, inputs, torch.eye(4), generator)) == 0


def test_rays_of_other_sensors_cannot_be_added():
    buffer, generator = filled(0, keyframes=1), torch.Generator()
    with pytest.raises(ValueError, match="sensors"):
        buffer.add(replace(make_rays(0, 5), sensors=("b", "a")), generator)


def test_rays_follow_their_cameras_and_no_others():
    """A quarter turn about z, then a translation: worked out by hand."""
    buffer, generator = empty_buffer(), torch.Generator().manual_seed(0)
    buffer.add(make_rays(0, 4), generator)
    buffer.add(make_rays(100, 3), generator)
    before = buffer.rays
    frames = before.frames.unique()
    assert len(frames) == 2
    turn = torch.tensor([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]], dtype=torch.float64)
    buffer.move({int(frames[1]): turn, 999: torch.eye(4)})
    moved, rows = buffer.rays, before.frames == frames[1]
    x, y, z = before.origins[rows].unbind(-1)
    torch.testing.assert_close(moved.origins[rows], torch.stack([5 - y, 6 + x, 7 + z], -1))
    x, y, z = before.directions[rows].unbind(-1)
    torch.testing.assert_close(moved.directions[rows], torch.stack([-y, x, z], -1))
    for name, values in moved.columns().items():
        assert torch.equal(values[~rows], before.columns()[name][~rows])
    assert torch.equal(moved.depths, before.depths)
