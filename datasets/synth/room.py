"""A procedural furnished room: seeded, textured, with plain walls, a window opening and two lights."""

from __future__ import annotations

import numpy as np

from . import textures as tx
from .furniture import PIECES, Finishes, Piece, chair
from .scene import Builder, Finish, Light, Scene

_GAP_M = 0.08  # between footprints
_CHAIRS = ((0.0, -1.0, np.pi), (0.0, 1.0, 0.0), (1.0, 0.0, -np.pi / 2), (-1.0, 0.0, np.pi / 2))  # side x, side y, yaw


def furnished_room(seed: int) -> Scene:
    """A room of 4..6 x 4..6 x 2.5..3 m with 8 to 16 pieces of furniture; the middle of its floor is the origin."""
    rng = np.random.default_rng([seed, 1])
    builder = Builder(rng)
    size = np.array([rng.uniform(4.2, 6.0), rng.uniform(4.2, 5.6), rng.uniform(2.5, 2.95)])
    window = _shell(builder, size)
    contents = _furnish(builder, size)
    _pictures(builder, size)
    lamp = Light(np.array([0.0, 0.0, size[2] - 0.25]), 0.3 * np.eye(3)[:2], np.array([4.6, 4.1, 3.5]))
    return builder.build((lamp, window), tuple(contents))


def _wall_frame(builder: Builder, size: np.ndarray, wall: int) -> tuple[Builder, float]:
    """A frame on the floor at the middle of a wall, x along it and y into the wall; and the wall's length."""
    yaw = wall * np.pi / 2
    reach = (size[1] if wall % 2 == 0 else size[0]) / 2
    origin = reach * np.array([-np.sin(yaw), np.cos(yaw)])
    return builder.placed(origin[0], origin[1], 0.0, yaw), float(size[0] if wall % 2 == 0 else size[1])


def _shell(b: Builder, size: np.ndarray) -> Light:
    """Floor, ceiling, walls, skirting boards, a door and a window opening; returns the light of the window."""
    rng = b.rng
    if rng.uniform() < 0.7:
        floor = b.finish(tx.planks(rng, [150, 108, 70]), 1.3)
    else:
        floor = b.finish(tx.tiles(rng, [196, 188, 172], [128, 108, 92]), 1.6)
    x, y, height = size
    ceiling = b.finish(tx.plaster(rng, [226, 224, 218]), 2.0)
    b.patch([-x / 2, y / 2, 0], [x, 0, 0], [0, -y, 0], floor)
    b.patch([-x / 2, -y / 2, height], [x, 0, 0], [0, y, 0], ceiling)
    soft = tx.hue(rng, 0.12, 0.88)
    papers = [
        b.finish(tx.wallpaper(rng, soft, soft * 0.86), 1.1),
        b.finish(tx.plaster(rng, tx.hue(rng, 0.1, 0.86)), 2.0),
        b.finish(tx.bricks(rng, [152, 92, 70]), 1.2),
        b.finish(tx.plaster(rng, tx.hue(rng, 0.12, 0.9)), 2.0),
    ]
    if rng.uniform() < 0.5:
        papers[2] = b.finish(tx.rough_plaster(rng, tx.hue(rng, 0.3, 0.8)), 1.5)
    order = rng.permutation(4)
    trim = b.finish(tx.wood(rng, [205, 198, 186]), 1.0)
    lights: list[Light] = []
    for wall in range(4):
        frame, length = _wall_frame(b, size, wall)
        paper = papers[order[wall]]
        frame.box([length, 0.02, 0.09], [0, -0.01, 0.045], trim)
        if wall == 0:
            lights.append(_window_wall(frame, length, height, paper, trim))
            continue
        frame.patch([-length / 2, 0, height], [length, 0, 0], [0, 0, -height], paper, (0, 0))
        if wall == 2:
            _door(frame, rng.uniform(-0.3, 0.3) * length, trim)
    frame_lamp = b.finish(tx.fabric(rng, [240, 225, 190]), 0.3)
    b.cylinder(0.015, 0.16, [0, 0, height - 0.08], trim)
    b.cylinder(0.2, 0.12, [0, 0, height - 0.2], frame_lamp, 0.1)
    return lights[0]


def _window_wall(b: Builder, length: float, height: float, paper: Finish, trim: Finish) -> Light:
    """A wall with an opening: what lies behind it has no depth."""
    width, low, high = b.rng.uniform(1.2, 1.6), 0.95, height - 0.4
    middle = b.rng.uniform(-0.15, 0.15) * length
    left, right = middle - width / 2, middle + width / 2
    for x0, x1, z0, z1 in (
        (-length / 2, left, 0, height), (right, length / 2, 0, height),
        (left, right, 0, low), (left, right, high, height),
    ):  # fmt: skip
        b.patch([x0, 0, z1], [x1 - x0, 0, 0], [0, 0, z0 - z1], paper, (x0 + length / 2, height - z1))
    deep, bar = 0.16, 0.06
    b.box([width + 0.16, deep + 0.1, 0.04], [middle, deep / 2 - 0.05, low - 0.02], trim)
    b.box([width, deep, 0.03], [middle, deep / 2, high - 0.015], trim)
    for x in (left + 0.015, right - 0.015):
        b.box([0.03, deep, high - low], [x, deep / 2, (low + high) / 2], trim)
    b.box([bar, bar, high - low], [middle, deep - bar / 2, (low + high) / 2], trim)
    b.box([width, bar, bar], [middle, deep - bar / 2, low + 0.6 * (high - low)], trim)
    center = b.to_world([middle, 0.3, (low + high) / 2])
    ends = np.stack([b.to_world([right, 0.3, (low + high) / 2]), b.to_world([middle, 0.3, high])])
    return Light(center, ends - center, np.array([4.2, 4.7, 5.3]))


def _door(b: Builder, x: float, trim: Finish) -> None:
    rng = b.rng
    leaf = b.finish(tx.wood(rng, [176, 138, 96]), 1.2)
    b.box([0.9, 0.04, 2.02], [x, -0.02, 1.01], leaf)
    for side in (-0.48, 0.48):
        b.box([0.08, 0.06, 2.1], [x + side, -0.03, 1.05], trim)
    b.box([1.04, 0.06, 0.08], [x, -0.03, 2.08], trim)
    for z in (0.55, 1.45):
        b.box([0.62, 0.015, 0.66], [x, -0.047, z], leaf)
    b.ball(0.035, [x + 0.36, -0.08, 1.02], trim)


def _furnish(b: Builder, size: np.ndarray) -> list[str]:
    """Place what fits; returns the names of what stands in the room."""
    rng, finishes = b.rng, Finishes.make(b)
    taken: list[np.ndarray] = []
    names: list[str] = []
    rug = b.finish(tx.carpet(rng, tx.hue(rng, 0.5, 0.6), tx.hue(rng, 0.35, 0.75)))
    b.placed(*rng.uniform(-0.3, 0.3, 2)).box([rng.uniform(1.8, 2.4), rng.uniform(1.3, 1.7), 0.012], [0, 0, 0.006], rug)
    for piece in PIECES:
        for _ in range(40):
            width, depth = rng.uniform(*piece.width), rng.uniform(*piece.depth)
            x, y, yaw = _try_place(rng, size, piece, width, depth)
            footprint = _footprint(x, y, yaw, width, depth)
            if all(_apart(footprint, other) for other in taken):
                frame = b.placed(x, y, 0.0, yaw)
                piece.draw(frame, finishes, width, depth)
                taken.append(footprint)
                names.append(piece.name)
                if piece.name == "table":
                    names += _chairs(b, finishes, (x, y, yaw, width, depth), size, taken)
                break
    return names


def _try_place(
    rng: np.random.Generator, size: np.ndarray, piece: Piece, width: float, depth: float
) -> tuple[float, float, float]:
    if not piece.against_wall:
        room = size[:2] / 2 - max(width, depth) / 2 - 0.75
        return (*rng.uniform(-np.maximum(room, 0.05), np.maximum(room, 0.05)), rng.integers(2) * np.pi / 2)
    walls = (1, 3) if piece.name == "bookshelf" else (0, 1, 2, 3)  # nothing tall before window or door
    wall = walls[rng.integers(len(walls))]
    yaw = wall * np.pi / 2
    length, reach = (size[0], size[1] / 2) if wall % 2 == 0 else (size[1], size[0] / 2)
    along = rng.uniform(-1, 1) * (length / 2 - width / 2 - 0.06)
    back = reach - depth / 2 - 0.08
    cos, sin = np.cos(yaw), np.sin(yaw)
    return along * cos - back * sin, along * sin + back * cos, yaw


def _chairs(
    b: Builder,
    finishes: Finishes,
    table: tuple[float, float, float, float, float],
    size: np.ndarray,
    taken: list[np.ndarray],
) -> list[str]:
    """Chairs at the sides of a table, where there is room."""
    x, y, yaw, width, depth = table
    cos, sin = np.cos(yaw), np.sin(yaw)
    names = []
    for side_x, side_y, turn in _CHAIRS:
        dx, dy = side_x * (width / 2 + 0.22), side_y * (depth / 2 + 0.22)
        cx, cy = x + cos * dx - sin * dy, y + sin * dx + cos * dy
        footprint = _footprint(cx, cy, yaw + turn, 0.44, 0.46)
        inside = np.all(np.abs(footprint) < np.tile(size[:2] / 2 - 0.1, 2))
        if inside and all(_apart(footprint, other) for other in taken[:-1]):
            chair(b.placed(cx, cy, 0.0, yaw + turn + b.rng.normal(0, 0.1)), finishes)
            taken.insert(0, footprint)
            names.append("chair")
    return names


def _footprint(x: float, y: float, yaw: float, width: float, depth: float) -> np.ndarray:
    """(4,) lowest x, y and highest x, y of a piece that stands along an axis."""
    half = np.array([width, depth] if abs(np.cos(yaw)) > 0.5 else [depth, width]) / 2
    return np.array([x - half[0], y - half[1], x + half[0], y + half[1]])


def _apart(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.any(a[:2] > b[2:] + _GAP_M) or np.any(b[:2] > a[2:] + _GAP_M))


def _pictures(b: Builder, size: np.ndarray) -> None:
    """Pictures on the walls without a window, above the furniture; one plain wall is left alone."""
    for wall in (1, 2, 3):
        frame, length = _wall_frame(b, size, wall)
        for slot in range(int(b.rng.integers(0, 3)) if wall == 3 else 2):
            width, height = b.rng.uniform(0.45, 0.8), b.rng.uniform(0.4, 0.6)
            x = (slot - 0.5) * length * 0.5 + b.rng.uniform(-0.3, 0.3)
            finish = b.finish(tx.painting(b.rng))
            frame.box([width, 0.03, height], [x, -0.015, b.rng.uniform(1.55, 1.75)], finish)
