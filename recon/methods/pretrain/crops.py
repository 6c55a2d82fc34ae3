"""Cubes cut out of synthetic rooms, turned at random: what the decoders learn from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from .rooms import Rooms, draw_rooms

CANDIDATES = 24  # places tried for a cube; the one nearest to a surface is taken


@dataclass(frozen=True)
class Crops:
    """S cubes with their axes along the grid, each in its own room."""

    rooms: Rooms
    center: Tensor  # (S, 3) of the cube in the room's frame, metres
    rotation: Tensor  # (S, 3, 3) R_room_crop

    def signed_distance(self, points: Tensor) -> Tensor:
        """points: (S, P, 3) metres from the cube's centre. Returns (S, P), metres, negative in solids."""
        return self.rooms.signed_distance(points @ self.rotation.transpose(1, 2) + self.center[:, None])


def draw_crops(count: int, generator: torch.Generator, tilted: float = 0.5) -> Crops:
    """Cubes near surfaces of new rooms; the share `tilted` is turned about all axes, the others about the vertical."""
    rooms = draw_rooms(count, generator)
    place = torch.rand(count, CANDIDATES, 3, generator=generator, device=generator.device)
    place = (place - place.new_tensor([0.5, 0.5, 0.0])) * (rooms.size[:, None] + 0.2)
    best = rooms.signed_distance(place).abs().argmin(dim=1)
    center = place[torch.arange(count, device=place.device), best]
    return Crops(rooms.around(center), center, _rotations(count, generator, tilted))


def _rotations(count: int, generator: torch.Generator, tilted: float) -> Tensor:
    """(S, 3, 3): uniform over all rotations, or about z alone."""
    quaternion = torch.randn(count, 4, generator=generator, device=generator.device)
    upright = torch.rand(count, 1, generator=generator, device=generator.device) >= tilted
    quaternion = torch.where(upright, quaternion * quaternion.new_tensor([1.0, 0.0, 0.0, 1.0]), quaternion)
    w, x, y, z = torch.nn.functional.normalize(quaternion, dim=1).unbind(dim=1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    ]  # fmt: skip
    return torch.stack(rows, dim=1).reshape(count, 3, 3)


def sample_crops(crops: Crops, points: int, extent_m: float, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Places in the cubes, half of them anywhere and half near surfaces, with their signed distances.

    The latter are the nearest to a surface of four times as many. Returns (S, points, 3) and (S, points), metres.
    """
    count = len(crops.center)
    places = torch.rand(count, points * 5 // 2, 3, generator=generator, device=generator.device)
    places = (places - 0.5) * extent_m
    distance = crops.signed_distance(places)
    anywhere = points // 2
    near = distance[:, anywhere:].abs().topk(points - anywhere, dim=1, largest=False).indices + anywhere
    index = torch.cat([torch.arange(anywhere, device=near.device).expand(count, -1), near], dim=1)
    return places.gather(1, index[..., None].expand(-1, -1, 3)), distance.gather(1, index)
