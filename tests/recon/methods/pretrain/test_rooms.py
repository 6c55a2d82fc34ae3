"""Made rooms: distances against known answers, occupancy against plain inclusion tests, seeds."""

import math

import pytest
import torch
from uncle.recon.methods.pretrain.crops import draw_crops, sample_crops
from uncle.recon.methods.pretrain.rooms import PIECES, Rooms, draw_rooms


def bare_room(**parts) -> Rooms:
    """A room of 4 x 6 x 3 m with walls of 0.1 m and nothing in it but `parts`."""
    empty = {
        "box_center": torch.zeros(1, 1, 3), "box_half": torch.full((1, 1, 3), -1e3), "box_yaw": torch.zeros(1, 1),
        "cylinder": torch.tensor([[[0.0, 0, -50, 0.1, 0.1]]]),
        "ellipsoid": torch.tensor([[[0.0, 0, -50, 0.1, 0.1, 0.1]]]),
    }  # fmt: skip
    return Rooms(size=torch.tensor([[4.0, 6.0, 3.0]]), wall=torch.tensor([0.1]), **{**empty, **parts})


def distances(room: Rooms, *points) -> list[float]:
    return room.signed_distance(torch.tensor([points]))[0].tolist()


def test_the_shell_is_as_thick_as_its_walls():
    found = distances(bare_room(), (0, 0, 1.5), (1.7, 0, 1.5), (2.05, 0, 1.5), (2.3, 0, 1.5), (0, 0, -0.03))
    assert found == pytest.approx([1.5, 0.3, -0.05, 0.2, -0.03], abs=1e-5)


def test_a_turned_box():
    box = {"box_center": torch.tensor([[[0.0, 0, 1]]]), "box_half": torch.tensor([[[0.5, 0.1, 0.2]]]),
           "box_yaw": torch.tensor([[math.pi / 2]])}  # fmt: skip
    found = distances(bare_room(**box), (0, 0.7, 1), (0.3, 0, 1), (0, 0, 1), (0, 0, 1.25))
    assert found == pytest.approx([0.2, 0.2, -0.1, 0.05], abs=1e-5)


def test_cylinder_and_sphere():
    parts = {
        "cylinder": torch.tensor([[[0.0, 0, 1, 0.2, 0.5]]]),
        "ellipsoid": torch.tensor([[[1.0, 0, 1, 0.3, 0.3, 0.3]]]),
    }
    found = distances(bare_room(**parts), (0, 0.5, 1), (0, 0, 1.7), (0, 0.1, 1), (1, 0.5, 1), (1, 0.2, 1))
    assert found == pytest.approx([0.3, 0.2, -0.1, 0.2, -0.1], abs=1e-4)


def test_the_sign_agrees_with_plain_inclusion():
    """In rooms of every kind of furniture, point by point."""
    generator = torch.Generator().manual_seed(4)
    rooms = draw_rooms(3, generator)
    points = (torch.rand(3, 400, 3, generator=generator) - torch.tensor([0.5, 0.5, 0.1])) * rooms.size[:, None] * 1.1
    solid = rooms.signed_distance(points) < 0
    for s in range(3):
        for point, found in zip(points[s], solid[s], strict=True):
            things = (*_boxes_hold(rooms, s, point), *_round_hold(rooms, s, point), _shell_holds(rooms, s, point))
            assert bool(found) == any(things)


def _shell_holds(rooms, s, point):
    width, depth, height = rooms.size[s].tolist()
    x, y, z = point.tolist()
    beyond = [max(0.0, abs(x) - width / 2), max(0.0, abs(y) - depth / 2), max(0.0, -z, z - height)]
    return 0 < math.hypot(*beyond) < rooms.wall[s]


def _boxes_hold(rooms, s, point):
    for center, half, yaw in zip(rooms.box_center[s], rooms.box_half[s], rooms.box_yaw[s], strict=True):
        x, y, z = (point - center).tolist()
        cos, sin = math.cos(yaw), math.sin(yaw)
        yield abs(cos * x + sin * y) < half[0] and abs(cos * y - sin * x) < half[1] and abs(z) < half[2]


def _round_hold(rooms, s, point):
    for x, y, z, radius, height in rooms.cylinder[s].tolist():
        yield math.hypot(point[0] - x, point[1] - y) < radius and abs(point[2] - z) < height
    for ellipsoid in rooms.ellipsoid[s]:
        yield (((point - ellipsoid[:3]) / ellipsoid[3:]) ** 2).sum() < 1


def test_every_piece_stands_in_some_room():
    rooms = draw_rooms(40, torch.Generator().manual_seed(0))
    assert rooms.size.amin() > 2
    present = (rooms.box_half > 0).all(dim=2).float().mean()
    assert 0.3 < present < 0.9  # pieces differ in their number of boxes
    assert len(PIECES) == 6


def test_a_seed_fixes_the_rooms():
    first, again, other = (draw_rooms(2, torch.Generator().manual_seed(seed)) for seed in (1, 1, 2))
    assert torch.equal(first.box_center, again.box_center)
    assert not torch.equal(first.size, other.size)


def test_only_near_things_are_kept_and_none_is_moved():
    generator = torch.Generator().manual_seed(3)
    rooms = draw_rooms(5, generator)
    center = torch.tensor([0.0, 0.0, 0.5]).expand(5, 3)
    everything, near = (
        rooms.signed_distance(center[:, None]),
        rooms.around(center, 4, 2).signed_distance(center[:, None]),
    )
    torch.testing.assert_close(everything, near)


def test_crops_hold_surfaces_and_samples_stay_inside():
    generator = torch.Generator().manual_seed(5)
    crops = draw_crops(20, generator)
    points, distance = sample_crops(crops, 1000, 1.28, generator)
    assert points.abs().amax() <= 0.64
    torch.testing.assert_close(crops.signed_distance(points), distance)
    solid = (distance < 0).float().mean(dim=1)
    assert ((solid > 0.01) & (solid < 0.99)).float().mean() > 0.9
    assert distance[:, 500:].abs().mean() < 0.5 * distance[:, :500].abs().mean()


def test_crops_are_turned_by_rotations():
    rotation = draw_crops(50, torch.Generator().manual_seed(6), tilted=0.5).rotation
    torch.testing.assert_close(rotation @ rotation.transpose(1, 2), torch.eye(3).expand(50, 3, 3), atol=1e-5, rtol=0)
    assert torch.linalg.det(rotation).amin() > 0.99
    upright = (rotation[:, 2, 2] > 0.9999).float().mean()
    assert 0.2 < upright < 0.8
