"""Pieces of furniture, each drawn around the origin of its own frame: x along its width, its back towards +y, z up.

Every function returns nothing and adds boxes, cylinders and balls to the builder; sizes are metres.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from . import textures as tx
from .scene import Builder, Finish


@dataclass(frozen=True)
class Finishes:
    """Textures that all furniture of a room shares."""

    woods: tuple[Finish, ...]
    fabrics: tuple[Finish, ...]
    paints: tuple[Finish, ...]
    books: Finish
    marble: Finish
    leaves: Finish
    metal: Finish
    lamp_shade: Finish

    @staticmethod
    def make(b: Builder) -> Finishes:
        """Draw the textures of a room, from the random numbers of its builder."""
        rng = b.rng
        woods = tuple(b.finish(tx.wood(rng, color), 0.9) for color in ([150, 100, 58], [96, 60, 38], [196, 160, 112]))
        fabrics = tuple(b.finish(tx.fabric(rng, tx.hue(rng, 0.45, 0.6)), 0.6) for _ in range(2))
        patterned = b.finish(tx.wallpaper(rng, tx.hue(rng, 0.4, 0.75), tx.hue(rng, 0.3, 0.9)), 0.5)
        paints = tuple(b.finish(tx.rough_plaster(rng, tx.hue(rng, 0.5, 0.7)), 0.8) for _ in range(2))
        return Finishes(
            woods, (*fabrics, patterned), paints,
            books=b.finish(tx.book_spines(rng), 0.55), marble=b.finish(tx.marble(rng, [205, 200, 190]), 0.8),
            leaves=b.finish(tx.leaves(rng), 0.35), metal=b.finish(tx.rough_plaster(rng, [120, 122, 128]), 0.4),
            lamp_shade=b.finish(tx.fabric(rng, [226, 205, 165]), 0.4),
        )  # fmt: skip

    def wood(self, rng: np.random.Generator) -> Finish:
        """One of the woods, at random."""
        return self.woods[rng.integers(len(self.woods))]

    def cloth(self, rng: np.random.Generator) -> Finish:
        """One of the fabrics, at random."""
        return self.fabrics[rng.integers(len(self.fabrics))]

    def paint(self, rng: np.random.Generator) -> Finish:
        """One of the paints, at random."""
        return self.paints[rng.integers(len(self.paints))]


def _legs(b: Builder, width: float, depth: float, height: float, finish: Finish, thick: float = 0.05) -> None:
    for x in (-1, 1):
        for y in (-1, 1):
            center = [x * (width - thick) / 2, y * (depth - thick) / 2, height / 2]
            b.box([thick, thick, height], center, finish)


def table(b: Builder, f: Finishes, width: float, depth: float) -> None:
    """A dining table with a bowl of fruit and a vase."""
    wood = f.wood(b.rng)
    top = f.marble if b.rng.uniform() < 0.3 else wood
    b.box([width, depth, 0.04], [0, 0, 0.73], top)
    b.box([width - 0.16, depth - 0.16, 0.07], [0, 0, 0.675], wood)
    _legs(b, width - 0.06, depth - 0.06, 0.71, wood, 0.07)
    b.lathe([[0.14, 0.07], [0.06, 0.0], [0.0, 0.0]], [-0.2 * width, 0.05, 0.752], f.paint(b.rng))
    for angle in np.arange(3) * 2.1:
        b.ball(0.045, [-0.2 * width + 0.05 * np.cos(angle), 0.05 + 0.05 * np.sin(angle), 0.8], f.paint(b.rng))
    vase(b.placed(0.25 * width, -0.05, 0.75), f, 0.24)


def vase(b: Builder, f: Finishes, height: float) -> None:
    """A bulged vase with twigs."""
    profile = np.array([[0.25, 1.0], [0.18, 0.85], [0.38, 0.45], [0.22, 0.0], [0.0, 0.0]]) * height
    b.lathe(profile, [0, 0, 0], f.paint(b.rng))
    for _ in range(5):
        x, y = b.rng.uniform(-0.3, 0.3, 2) * height
        b.ball(0.22 * height, [x, y, height * b.rng.uniform(1.05, 1.5)], f.leaves, 1.2)


def chair(b: Builder, f: Finishes, width: float = 0.44, depth: float = 0.46) -> None:
    """A chair with a slatted back."""
    wood = f.wood(b.rng)
    _legs(b, width, depth, 0.44, wood, 0.04)
    b.box([width, depth, 0.03], [0, 0, 0.455], wood)
    b.box([width - 0.05, depth - 0.06, 0.04], [0, -0.01, 0.49], f.cloth(b.rng))
    for x in (-1, 1):
        b.box([0.04, 0.04, 0.5], [x * (width - 0.04) / 2, depth / 2 - 0.02, 0.71], wood)
    for z in (0.62, 0.76, 0.9):
        b.box([width - 0.08, 0.025, 0.07], [0, depth / 2 - 0.02, z], wood)


def sofa(b: Builder, f: Finishes, width: float, depth: float) -> None:
    """A sofa with seat cushions and two loose ones."""
    cloth = f.cloth(b.rng)
    b.box([width, depth, 0.3], [0, 0, 0.2], cloth)
    b.box([width, 0.22, 0.5], [0, depth / 2 - 0.11, 0.58], cloth)
    for side in (-1, 1):
        b.box([0.18, depth, 0.3], [side * (width / 2 - 0.09), 0, 0.47], cloth)
    seats = max(1, round((width - 0.36) / 0.65))
    step = (width - 0.36) / seats
    for i in range(seats):
        x = -width / 2 + 0.18 + (i + 0.5) * step
        b.box([step - 0.02, depth - 0.24, 0.13], [x, -0.1, 0.415], cloth)
    for side in (-1, 1)[: max(1, seats - 1)]:
        b.ball(0.17, [side * (width / 2 - 0.38), 0.08, 0.6], f.cloth(b.rng), 0.85)
    _legs(b, width - 0.1, depth - 0.1, 0.06, f.metal)


def bookshelf(b: Builder, f: Finishes, width: float, depth: float, height: float = 1.9) -> None:
    """Open shelves with rows of books and a few objects."""
    wood, thick = f.wood(b.rng), 0.03
    b.box([width, 0.02, height], [0, depth / 2 - 0.01, height / 2], wood)
    for side in (-1, 1):
        b.box([thick, depth, height], [side * (width - thick) / 2, 0, height / 2], wood)
    levels = np.linspace(0.05, height - 0.02, 6)
    for z in levels:
        b.box([width - 2 * thick, depth - 0.02, thick], [0, -0.01, z], wood)
    for z in levels[:-1]:
        x, end = -width / 2 + thick, width / 2 - thick
        while x < end - 0.1:
            run = min(b.rng.uniform(0.1, 0.35), end - x)
            tall, deep = b.rng.uniform(0.2, 0.29), b.rng.uniform(0.14, depth - 0.07)
            if b.rng.uniform() < 0.8:
                b.box([run, deep, tall], [x + run / 2, depth / 2 - 0.03 - deep / 2, z + thick / 2 + tall / 2], f.books)
            else:
                b.ball(0.05, [x + run / 2, 0, z + thick / 2 + 0.05], f.paint(b.rng))
            x += run


def cabinet(b: Builder, f: Finishes, width: float, depth: float, height: float = 0.85) -> None:
    """A chest of drawers with a lamp or a vase on top."""
    body, front = f.wood(b.rng), f.paint(b.rng) if b.rng.uniform() < 0.5 else f.wood(b.rng)
    b.box([width, depth, height - 0.08], [0, 0, (height + 0.08) / 2], body)
    _legs(b, width - 0.04, depth - 0.04, 0.1, body)
    columns = max(1, round(width / 0.55))
    for i in range(columns):
        for j in range(3):
            w, h = width / columns, (height - 0.12) / 3
            x, z = -width / 2 + (i + 0.5) * w, 0.1 + (j + 0.5) * h
            b.box([w - 0.03, 0.025, h - 0.03], [x, -depth / 2 - 0.0125, z], front)
            b.ball(0.02, [x, -depth / 2 - 0.04, z], f.metal)
    vase(b.placed(-0.3 * width, 0, height), f, 0.28)
    b.cylinder(0.02, 0.3, [0.3 * width, 0, height + 0.15], f.metal)
    b.cylinder(0.16, 0.2, [0.3 * width, 0, height + 0.38], f.lamp_shade, 0.1)


def desk(b: Builder, f: Finishes, width: float, depth: float) -> None:
    """A desk with drawers, a screen, books and a keyboard."""
    wood = f.wood(b.rng)
    b.box([width, depth, 0.04], [0, 0, 0.73], wood)
    b.box([0.4, depth - 0.06, 0.69], [width / 2 - 0.22, 0, 0.355], f.wood(b.rng))
    b.box([0.04, depth - 0.04, 0.71], [-width / 2 + 0.04, 0, 0.355], wood)
    screen = b.finish(tx.painting(b.rng))
    b.box([0.5, 0.03, 0.31], [-0.1, 0.12, 1.0], screen)
    b.box([0.06, 0.05, 0.12], [-0.1, 0.14, 0.8], f.metal)
    b.box([0.22, 0.16, 0.015], [-0.1, 0.14, 0.757], f.metal)
    b.box([0.42, 0.14, 0.02], [-0.1, -0.14, 0.76], f.paint(b.rng))
    b.box([0.18, 0.24, 0.12], [width / 2 - 0.2, 0.05, 0.81], f.books)


def stool(b: Builder, f: Finishes, width: float = 0.38, _depth: float = 0.38) -> None:
    """A round padded stool."""
    b.cylinder(width / 2, 0.08, [0, 0, 0.42], f.cloth(b.rng))
    b.cylinder(width / 2 - 0.03, 0.36, [0, 0, 0.2], f.wood(b.rng), 0.06)


def plant(b: Builder, f: Finishes, _width: float = 0.5, _depth: float = 0.5) -> None:
    """A pot with a stem and a crown of leaves."""
    height = b.rng.uniform(0.9, 1.4)
    b.cylinder(0.13, 0.32, [0, 0, 0.16], f.paint(b.rng), 0.18)
    b.cylinder(0.025, height - 0.3, [0, 0, (height + 0.3) / 2], f.woods[1])
    for _ in range(16):
        direction = b.rng.normal(size=3)
        direction *= 0.2 / np.linalg.norm(direction)
        center = direction * [0.85, 0.85, 1.3] + [0, 0, height]
        b.ball(b.rng.uniform(0.05, 0.1), center, f.leaves, b.rng.uniform(0.6, 1.4))


def floor_lamp(b: Builder, f: Finishes, _width: float = 0.4, _depth: float = 0.4) -> None:
    """A standing lamp."""
    b.cylinder(0.15, 0.03, [0, 0, 0.015], f.metal)
    b.cylinder(0.015, 1.4, [0, 0, 0.72], f.metal)
    b.cylinder(0.2, 0.28, [0, 0, 1.5], f.lamp_shade, 0.13)


def boxes(b: Builder, f: Finishes, width: float = 0.6, depth: float = 0.5) -> None:
    """Stacked crates."""
    b.box([width, depth, 0.36], [0, 0, 0.18], f.wood(b.rng))
    b.placed(0.05, 0, 0.36, 0.3).box([width * 0.6, depth * 0.6, 0.26], [0, 0, 0.13], f.paint(b.rng))


@dataclass(frozen=True)
class Piece:
    """What may stand in a room: its name, drawing function and range of footprints (width, depth) in metres."""

    name: str
    draw: Callable[..., None]
    width: tuple[float, float]
    depth: tuple[float, float]
    against_wall: bool = True


PIECES = (
    Piece("sofa", sofa, (1.7, 2.2), (0.85, 0.95)),
    Piece("bookshelf", bookshelf, (0.8, 1.4), (0.3, 0.36)),
    Piece("table", table, (1.2, 1.7), (0.75, 0.9), against_wall=False),
    Piece("cabinet", cabinet, (0.9, 1.5), (0.42, 0.5)),
    Piece("desk", desk, (1.2, 1.5), (0.6, 0.7)),
    Piece("plant", plant, (0.5, 0.5), (0.5, 0.5)),
    Piece("floor lamp", floor_lamp, (0.4, 0.4), (0.4, 0.4)),
    Piece("armchair", sofa, (0.85, 1.0), (0.8, 0.9)),
    Piece("bookshelf", bookshelf, (0.6, 1.0), (0.28, 0.34)),
    Piece("stool", stool, (0.38, 0.38), (0.38, 0.38), against_wall=False),
    Piece("crates", boxes, (0.5, 0.7), (0.45, 0.55)),
    Piece("plant", plant, (0.5, 0.5), (0.5, 0.5)),
)
