"""Which frames become keyframes, and the store of their pixels."""

import numpy as np
import pytest
import torch
from uncle.recon.core.config.uncle import KeyframeConfig
from uncle.recon.core.frame import Frame
from uncle.recon.methods.uncle.keyframes import KeyframeSelector, mean_depth
from uncle.recon.methods.uncle.ray_buffer import RayBuffer


@pytest.fixture
def chosen(box_room):
    """Whether each of the frames seen along the given angles becomes a keyframe."""

    def choose(angles, config: KeyframeConfig | None = None) -> list[bool]:
        selector = KeyframeSelector(box_room.camera, config or KeyframeConfig())
        found = []
        for index, angle in enumerate(angles):
            pose = box_room.pose(angle)
            depth = torch.from_numpy(box_room.depth(pose)).float()
            frame = Frame(index, index, torch.zeros(120, 160, 3, dtype=torch.uint8), {"gt": depth}, pose)
            found.append(selector.is_keyframe(frame, torch.from_numpy(pose).float()))
        return found

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


def test_frames_without_readings_add_nothing(box_room):
    selector = KeyframeSelector(box_room.camera, KeyframeConfig())
    empty = Frame(0, 0, torch.zeros(120, 160, 3, dtype=torch.uint8), {"a": torch.zeros(120, 160)}, np.eye(4))
    assert sum(selector.is_keyframe(empty, torch.eye(4)) for _ in range(3)) <= 1


def test_mean_depth_is_over_those_that_have_a_reading():
    depths = {"a": torch.tensor([[1.0, 0.0, 0.0]]), "b": torch.tensor([[3.0, 2.0, 0.0]])}
    frame = Frame(0, 0, torch.zeros(1, 3, 3, dtype=torch.uint8), depths, None)
    torch.testing.assert_close(mean_depth(frame), torch.tensor([[2.0, 2.0, 0.0]]))


def rays(first: int, count: int) -> dict[str, torch.Tensor]:
    """Rays whose every column tells their number."""
    number = torch.arange(first, first + count).float()[:, None]
    return {
        "frames": torch.full((count,), first // 100), "origins": number.expand(-1, 3),
        "directions": -number.expand(-1, 3), "depths": number.expand(-1, 2),
        "colors": (number.expand(-1, 3) % 256).byte(), "features": (number[..., None] % 100).expand(-1, 2, 4).half(),
    }  # fmt: skip


def filled(seed: int, keyframes: int = 30) -> RayBuffer:
    store, generator = RayBuffer(1000), torch.Generator().manual_seed(seed)
    for index in range(keyframes):
        store.add(rays(index * 100, 100), generator)
    return store


def test_store_is_bounded_and_keeps_rays_whole():
    store = filled(0)
    assert len(store) == 1000
    number = store["depths"][:, 0]
    assert torch.equal(store["origins"][:, 1], number)
    assert torch.equal(store["directions"][:, 2], -number)
    assert torch.equal(store["colors"][:, 0].float(), number % 256)
    assert torch.equal(store["features"][:, 1, 3].float(), number % 100)
    assert len(number.unique()) == 1000


def test_store_keeps_old_and_new_keyframes():
    keyframe = (filled(0)["depths"][:, 0] / 100).floor()
    assert (keyframe < 10).sum() > 20
    assert (keyframe >= 20).sum() > 300


def test_store_is_seeded():
    assert torch.equal(filled(1)["depths"], filled(1)["depths"])
    assert not torch.equal(filled(1)["depths"], filled(2)["depths"])
    assert len(RayBuffer(10)) == 0


def test_rays_follow_their_cameras_and_no_others():
    """A quarter turn about z, then a step: worked out by hand."""
    store, generator = RayBuffer(1000), torch.Generator().manual_seed(0)
    store.add(rays(0, 4), generator)
    store.add(rays(100, 3), generator)
    before = {name: values.clone() for name, values in store.columns.items()}
    frames = before["frames"].unique()
    assert len(frames) == 2
    turn = torch.tensor([[0.0, -1, 0, 5], [1, 0, 0, 6], [0, 0, 1, 7], [0, 0, 0, 1]], dtype=torch.float64)
    store.move({int(frames[1]): turn, 999: torch.eye(4)})
    mine = before["frames"] == frames[1]
    x, y, z = before["origins"][mine].unbind(-1)
    torch.testing.assert_close(store["origins"][mine], torch.stack([5 - y, 6 + x, 7 + z], -1))
    x, y, z = before["directions"][mine].unbind(-1)
    torch.testing.assert_close(store["directions"][mine], torch.stack([-y, x, z], -1))
    for name in RayBuffer.FIELDS:
        assert torch.equal(store[name][~mine], before[name][~mine])
    assert torch.equal(store["depths"], before["depths"])
