"""A procedural corridor with corners, for long recordings, and the way along its middle."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from . import textures as tx
from .scene import Builder, Finish, Scene

HEIGHT_M = 2.5
_HALF_WIDTH_M = 1.0
_LEG_M = 25.0  # from corner to corner, about
_FIXTURE_M = 3.0  # from door to door and from picture to picture
_PICTURES = 12  # different ones
_STEP_M = 2.5  # from glance to glance
_EYE_M = 1.5
_PITCH = -0.1


def corridor(length_m: float, seed: int) -> Scene:
    """A corridor 2 m wide, closed on all sides; it begins at the origin and turns left and right by turns.

    It thus spreads over the ground as far to the north (y) as to the east (x).
    """
    builder = Builder(np.random.default_rng([seed, 1]))
    corners, ways = _centre_line(length_m)
    _shell(builder, corners, ways)
    _fixtures(builder, corners, ways)
    return builder.build((), (f"a corridor of {length_m:g} m with {len(ways) - 1} corners",))


def corridor_stations(length_m: float, rng: np.random.Generator) -> np.ndarray:
    """(K, 5) x, y, z, yaw, pitch along the middle of `corridor`, with glances to both sides; metres, radians."""
    corners, ways = _centre_line(length_m)
    stations, side = [], 1.0
    for start, end, way in zip(corners, corners[1:], ways, strict=False):
        reach = np.linalg.norm(end - start) - 2 * _HALF_WIDTH_M
        for along in np.linspace(0, reach, max(2, round(reach / _STEP_M))) + _HALF_WIDTH_M:
            yaw = np.arctan2(way[1], way[0]) + side * rng.uniform(0.2, 0.6)
            stations.append([*(start + along * way), _EYE_M, yaw, _PITCH])
            side = -side
    return np.array(stations)


def _centre_line(length_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Ends and corners (L + 1, 2) of the middle of the corridor, and the direction (L, 2) of each leg."""
    legs = max(1, round(length_m / _LEG_M))
    ways = np.array([[1.0, 0.0], [0.0, 1.0]])[np.arange(legs) % 2]
    return np.concatenate([np.zeros((1, 2)), np.cumsum(ways * (length_m / legs), axis=0)]), ways


def _shell(b: Builder, corners: np.ndarray, ways: np.ndarray) -> None:
    """Floor, ceiling, both walls and the two ends."""
    rng = b.rng
    floor = b.finish(tx.tiles(rng, [196, 188, 172], [128, 108, 92]), 1.6)
    ceiling = b.finish(tx.rough_plaster(rng, [226, 224, 218]), 2.0)
    papers = [
        b.finish(tx.bricks(rng, [170, 120, 96]), 1.2),
        b.finish(tx.rough_plaster(rng, tx.hue(rng, 0.3, 0.8)), 1.5),
    ]
    half = _HALF_WIDTH_M
    for leg, way in enumerate(ways):
        is_last = leg == len(ways) - 1
        start = corners[leg] - half * way  # each leg has the square of its first corner, the last one both
        length = float(np.linalg.norm(corners[leg + 1] - corners[leg])) + (2 * half if is_last else 0.0)
        frame = _leg_frame(b, start, way)
        frame.patch([0, half, 0], [length, 0, 0], [0, -2 * half, 0], floor)
        frame.patch([0, -half, HEIGHT_M], [length, 0, 0], [0, 2 * half, 0], ceiling)
    left, right = _walls(corners, ways)
    for wall, paper in zip((left, right), papers, strict=True):
        for a, z in pairwise(wall):
            _wall(b, a, z, paper)
    for end in (0, -1):
        _wall(b, left[end], right[end], papers[0])


def _leg_frame(b: Builder, start: np.ndarray, way: np.ndarray) -> Builder:
    """A frame on the floor, x along a leg and y to its left."""
    x, y = start.tolist()
    return b.placed(x, y, yaw=float(np.arctan2(way[1], way[0])))


def _walls(corners: np.ndarray, ways: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The left and the right wall, seen along the way, as lines (L + 1, 2)."""
    lefts = np.stack([-ways[:, 1], ways[:, 0]], axis=1)
    across = np.concatenate([lefts[:1], lefts[:-1] + lefts[1:], lefts[-1:]])
    ends = corners.copy()
    ends[0] -= _HALF_WIDTH_M * ways[0]
    ends[-1] += _HALF_WIDTH_M * ways[-1]
    return ends + _HALF_WIDTH_M * across, ends - _HALF_WIDTH_M * across


def _wall(b: Builder, start: np.ndarray, end: np.ndarray, paper: Finish) -> None:
    b.patch([*start, HEIGHT_M], [*(end - start), 0], [0, 0, -HEIGHT_M], paper)


def _fixtures(b: Builder, corners: np.ndarray, ways: np.ndarray) -> None:
    """Doors on the left, pictures on the right, lamps."""
    rng, half = b.rng, _HALF_WIDTH_M
    leaf, lamp = b.finish(tx.wood(rng, [176, 138, 96]), 1.2), b.finish(tx.fabric(rng, [240, 235, 225]), 0.3)
    pictures = [b.finish(tx.painting(rng)) for _ in range(_PICTURES)]
    for start, end, way in zip(corners, corners[1:], ways, strict=False):
        frame = _leg_frame(b, start, way)
        for x in np.arange(2 * half, np.linalg.norm(end - start) - half, _FIXTURE_M):
            frame.box([0.9, 0.04, 2.02], [x, half - 0.02, 1.01], leaf)
            size = [rng.uniform(0.5, 0.9), 0.03, rng.uniform(0.4, 0.6)]
            frame.box(size, [x + rng.uniform(-0.4, 0.4), 0.015 - half, 1.6], pictures[rng.integers(_PICTURES)])
            frame.box([1.2, 0.3, 0.06], [x, 0, HEIGHT_M - 0.03], lamp)
