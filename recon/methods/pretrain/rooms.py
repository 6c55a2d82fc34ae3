"""Furnished rooms as formulas: many at once, drawn on the device, with their exact distance to the surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

FURNITURE = 9  # pieces in a room
CLUTTER = 8  # small boxes, and as many cylinders and ellipsoids each
Uniform = Callable[..., Tensor]  # (*shape, low=0.0, high=1.0): random numbers
NOWHERE = 1e3  # half-size, metres below zero, of a box that is not there

# Boxes of each piece as (x0, x1, y0, y1, z0, z1), shares of its width, depth and height; a pair (share, k) adds k times
# the thickness of its boards.
Edge = float | tuple[float, float]
_LEGS: list[tuple[Edge, ...]] = [
    (x0, x1, y0, y1, 0.0, 1.0) for x0, x1 in ((0.0, (0.0, 1.0)), ((1.0, -1.0), 1.0))
    for y0, y1 in ((0.0, (0.0, 1.0)), ((1.0, -1.0), 1.0))
]  # fmt: skip
PIECES: dict[str, list[tuple[Edge, ...]]] = {
    "box": [(0.0, 1.0, 0.0, 1.0, 0.0, 1.0)],
    "table": [(0.0, 1.0, 0.0, 1.0, (1.0, -1.0), 1.0), *_LEGS],
    "chair": [(0.0, 1.0, 0.0, 1.0, (0.5, -1.0), 0.5), *[(*leg[:4], 0.0, 0.5) for leg in _LEGS],
              (0.0, 1.0, 0.0, (0.0, 1.0), 0.5, 1.0)],
    "sofa": [(0.0, 1.0, 0.0, 1.0, 0.05, 0.5), (0.0, 1.0, 0.0, 0.25, 0.5, 1.0), (0.0, 0.12, 0.0, 1.0, 0.5, 0.75),
             (0.88, 1.0, 0.0, 1.0, 0.5, 0.75)],
    "shelf": [(0.0, (0.0, 1.0), 0.0, 1.0, 0.0, 1.0), ((1.0, -1.0), 1.0, 0.0, 1.0, 0.0, 1.0),
              *[(0.0, 1.0, 0.0, 1.0, z, (z, 1.0)) for z in (0.05, 0.33, 0.62, 0.92)]],
    "panel": [(0.0, 1.0, 0.0, (0.0, 1.0), 0.0, 1.0)],
}  # fmt: skip
_BOXES = max(len(boxes) for boxes in PIECES.values())


def _edge_table() -> Tensor:
    """(pieces, boxes, 3 axes, lower and upper, share and thicknesses); boxes that are missing have upper < lower."""
    table = torch.zeros(len(PIECES), _BOXES, 3, 2, 2)
    table[..., 1, 1] = -NOWHERE
    for piece, boxes in enumerate(PIECES.values()):
        for box, edges in enumerate(boxes):
            values = [edge if isinstance(edge, tuple) else (edge, 0.0) for edge in edges]
            table[piece, box] = torch.tensor(values).reshape(3, 2, 2)
    return table


@dataclass(frozen=True)
class Rooms:
    """S rooms in their own frames: x, y in the plane of the floor, z up, metres, the floor's centre at the origin."""

    size: Tensor  # (S, 3) inner width, depth, height
    wall: Tensor  # (S,) thickness of walls, floor and ceiling
    box_center: Tensor  # (S, B, 3)
    box_half: Tensor  # (S, B, 3); negative: no box
    box_yaw: Tensor  # (S, B) radians
    cylinder: Tensor  # (S, C, 5): centre, radius, half height; upright
    ellipsoid: Tensor  # (S, C, 6): centre, half axes

    def signed_distance(self, points: Tensor) -> Tensor:
        """Distance to the nearest surface in metres, negative in solids, of points (S, P, 3); (S, P).

        Exact outside of boxes, cylinders and the room's inner faces, a good approximation elsewhere; the sign is exact.
        """
        inner = _box_distance(
            points[:, :, None], _half_room(self.size)[:, None, None], _center(self.size)[:, None, None]
        )
        shell = torch.maximum(-inner, inner - self.wall[:, None, None])
        return torch.cat([shell, self._boxes(points), self._round(points)], dim=2).amin(dim=2)

    def around(self, center: Tensor, boxes: int = 16, round_things: int = 4) -> Rooms:
        """The rooms with only the things nearest to `center` (S, 3) in each: cheaper, and as valid a room."""
        at = center[:, None]
        near = self._boxes(at)[:, 0].topk(boxes, dim=1, largest=False).indices
        cylinders, ellipsoids = self._round(at)[:, 0].chunk(2, dim=1)
        kept = [_pick(values, near) for values in (self.box_center, self.box_half, self.box_yaw[..., None])]
        return Rooms(
            self.size, self.wall, kept[0], kept[1], kept[2][..., 0],
            _pick(self.cylinder, cylinders.topk(round_things, dim=1, largest=False).indices),
            _pick(self.ellipsoid, ellipsoids.topk(round_things, dim=1, largest=False).indices),
        )  # fmt: skip

    def _boxes(self, points: Tensor) -> Tensor:
        offset = points[:, :, None] - self.box_center[:, None]  # (S, P, B, 3)
        cos, sin = torch.cos(self.box_yaw)[:, None], torch.sin(self.box_yaw)[:, None]
        x, y, z = offset.unbind(dim=-1)
        turned = torch.stack([cos * x + sin * y, cos * y - sin * x, z], dim=-1)
        return _box_distance(turned, self.box_half[:, None], torch.zeros_like(turned[:1, :1, :1]))

    def _round(self, points: Tensor) -> Tensor:
        offset = points[:, :, None] - self.cylinder[:, None, :, :3]
        radial = torch.linalg.vector_norm(offset[..., :2], dim=-1) - self.cylinder[:, None, :, 3]
        axial = offset[..., 2].abs() - self.cylinder[:, None, :, 4]
        outside = torch.hypot(radial.clamp(min=0), axial.clamp(min=0))
        cylinders = outside + torch.maximum(radial, axial).clamp(max=0)
        offset = points[:, :, None] - self.ellipsoid[:, None, :, :3]
        axes = self.ellipsoid[:, None, :, 3:]
        scaled = torch.linalg.vector_norm(offset / axes, dim=-1)
        steepness = torch.linalg.vector_norm(offset / axes.square(), dim=-1).clamp(min=1e-6)
        return torch.cat([cylinders, scaled * (scaled - 1.0) / steepness], dim=2)


def _pick(values: Tensor, index: Tensor) -> Tensor:
    """values (S, N, K) at index (S, M): (S, M, K)."""
    return values.gather(1, index[..., None].expand(-1, -1, values.shape[2]))


def _half_room(size: Tensor) -> Tensor:
    return size / 2


def _center(size: Tensor) -> Tensor:
    return size * size.new_tensor([0.0, 0.0, 0.5])


def _box_distance(points: Tensor, half: Tensor, center: Tensor) -> Tensor:
    """Distance of points (..., 3) to a box, negative inside; (...)."""
    beyond = (points - center).abs() - half
    return torch.linalg.vector_norm(beyond.clamp(min=0), dim=-1) + beyond.amax(dim=-1).clamp(max=0)


def draw_rooms(count: int, generator: torch.Generator) -> Rooms:
    """`count` random rooms on the generator's device: 3 to 7 m wide, 2.3 to 3.2 m high, walls of 6 to 25 cm."""
    device = generator.device

    def uniform(*shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return torch.rand(*shape, generator=generator, device=device) * (high - low) + low

    size = torch.cat([uniform(count, 2, low=3.0, high=7.0), uniform(count, 1, low=2.3, high=3.2)], dim=1)
    furniture = _draw_furniture(size, generator, uniform)
    places = [_inside(size, CLUTTER, uniform) for _ in range(3)]
    halves = [uniform(count, CLUTTER, 3, low=0.03, high=0.3) for _ in range(2)]
    cylinders = [uniform(count, CLUTTER, 1, low=0.03, high=0.3), uniform(count, CLUTTER, 1, low=0.05, high=0.7)]
    return Rooms(
        size=size, wall=uniform(count, low=0.06, high=0.25),
        box_center=torch.cat([furniture[0], places[0]], dim=1), box_half=torch.cat([furniture[1], halves[0]], dim=1),
        box_yaw=torch.cat([furniture[2], uniform(count, CLUTTER, high=6.2832)], dim=1),
        cylinder=torch.cat([places[1], *cylinders], dim=2), ellipsoid=torch.cat([places[2], halves[1]], dim=2),
    )  # fmt: skip


def _inside(size: Tensor, number: int, uniform: Uniform) -> Tensor:
    """Random places in the rooms, (S, number, 3); half of them low, where things lie."""
    place = uniform(len(size), number, 3)
    place[:, : number // 2, 2] *= 0.4
    return (place - place.new_tensor([0.5, 0.5, 0.0])) * size[:, None]


def _draw_furniture(size: Tensor, generator: torch.Generator, uniform: Uniform) -> tuple[Tensor, Tensor, Tensor]:
    """Centres (S, B, 3), half-sizes (S, B, 3) and yaws (S, B) of the boxes of all pieces."""
    count, device = len(size), size.device
    kind = torch.randint(len(PIECES), (count, FURNITURE), generator=generator, device=device)
    extent = torch.cat([
        uniform(count, FURNITURE, 1, low=0.4, high=2.0), uniform(count, FURNITURE, 1, low=0.3, high=1.0),
        uniform(count, FURNITURE, 1, low=0.35, high=2.0),
    ], dim=2)  # fmt: skip
    board = uniform(count, FURNITURE, low=0.02, high=0.09)
    table = _edge_table().to(device)[kind]  # (S, F, boxes, 3, 2, 2)
    edges = table[..., 0] * extent[:, :, None, :, None] + table[..., 1] * board[:, :, None, None, None]
    low, high = edges.unbind(dim=-1)
    quarter = torch.randint(4, (count, FURNITURE), generator=generator, device=device) * (torch.pi / 2)
    loose = uniform(count, FURNITURE, high=6.2832) * (uniform(count, FURNITURE) < 0.3)
    yaw = quarter + loose
    middle = (low + high) / 2 - extent[:, :, None] * extent.new_tensor([0.5, 0.5, 0.0])
    x, y, z = middle.unbind(dim=-1)
    cos, sin = torch.cos(yaw)[..., None], torch.sin(yaw)[..., None]
    place = (uniform(count, FURNITURE, 2, low=-0.5, high=0.5) * size[:, None, :2])[:, :, None]
    center = torch.stack([cos * x - sin * y + place[..., 0], sin * x + cos * y + place[..., 1], z], dim=-1)
    half = (high - low) / 2
    return center.flatten(1, 2), half.flatten(1, 2), yaw[..., None].expand(-1, -1, _BOXES).flatten(1, 2)
