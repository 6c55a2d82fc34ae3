"""A textured scene as a value, and the builder that furniture is made with."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Light:
    """A glowing disc or rectangle: `center` (3,) and two half axes (2, 3), metres; `color` (3,) linear RGB power."""

    center: np.ndarray
    half_axes: np.ndarray
    color: np.ndarray


@dataclass(frozen=True)
class Scene:
    """Triangles with textures, z up, metres.

    vertices (V, 3) float32; faces (F, 3) int32
    uvs (F, 3, 2) float32 per corner, one texture = 0..1, v grows downwards in the image; beyond that it repeats
    texture_ids (F,) int16 into `textures`, a tuple of (h, w, 3) uint8 sRGB images
    tints (F, 3, 3) float32 linear factor per corner, or None
    lights: none means the even light of an overcast sky
    """

    vertices: np.ndarray
    faces: np.ndarray
    uvs: np.ndarray
    texture_ids: np.ndarray
    textures: tuple[np.ndarray, ...]
    tints: np.ndarray | None = None
    lights: tuple[Light, ...] = ()
    contents: tuple[str, ...] = ()  # what stands in it, for people

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,), (3,)."""
        return self.vertices.min(axis=0), self.vertices.max(axis=0)


@dataclass(frozen=True)
class Finish:
    """A texture as it is applied: `tile_m` metres per repeat, or 0 to stretch one texture over each face."""

    texture: int
    tile_m: float


@dataclass
class _Parts:
    vertices: list[np.ndarray] = field(default_factory=list)
    faces: list[np.ndarray] = field(default_factory=list)
    uvs: list[np.ndarray] = field(default_factory=list)
    texture_ids: list[np.ndarray] = field(default_factory=list)
    textures: list[np.ndarray] = field(default_factory=list)
    count: int = 0


class Builder:
    """Collects boxes, cylinders and balls. `placed` gives a builder in the frame of one piece of furniture."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self._parts = _Parts()
        self._origin = np.zeros(3)
        self._rotation = np.eye(3)

    def placed(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> Builder:
        """The same scene seen from a frame at (x, y, z) metres, turned by `yaw` radians about z."""
        child = Builder(self.rng)
        child._parts = self._parts
        child._origin = self._origin + self._rotation @ np.array([x, y, z])
        cos, sin = np.cos(yaw), np.sin(yaw)
        child._rotation = self._rotation @ np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return child

    def to_world(self, point: ArrayLike) -> np.ndarray:
        """A point (3,) of this frame in the scene."""
        return self._rotation @ np.asarray(point, dtype=float) + self._origin

    def finish(self, image: np.ndarray, tile_m: float = 0.0) -> Finish:
        """Register a texture."""
        self._parts.textures.append(image)
        return Finish(len(self._parts.textures) - 1, tile_m)

    def patch(
        self, corner: ArrayLike, right: ArrayLike, down: ArrayLike, finish: Finish, uv0: ArrayLike | None = None
    ) -> None:
        """A rectangle from its upper left corner and two edges; `uv0` (2,) metres fixes where the texture starts."""
        corner, right, down = (np.asarray(x, dtype=float) for x in (corner, right, down))
        size = np.array([np.linalg.norm(right), np.linalg.norm(down)])
        square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
        uv = square
        if finish.tile_m > 0:
            start = self.rng.uniform(0, finish.tile_m, 2) if uv0 is None else np.asarray(uv0)
            uv = (start + square * size) / finish.tile_m
        points = corner + square[:, :1] * right + square[:, 1:] * down
        self._add(points, np.array([[0, 2, 1], [0, 3, 2]]), uv, finish)

    def box(self, size: ArrayLike, center: ArrayLike, finish: Finish) -> None:
        """An upright box: size and center (3,) metres in this frame."""
        sx, sy, sz = np.asarray(size, dtype=float)
        x0, y0, z0 = np.asarray(center, dtype=float) - [sx / 2, sy / 2, sz / 2]
        x1, y1, z1 = x0 + sx, y0 + sy, z0 + sz
        ex, ey, ez = np.array([sx, 0, 0]), np.array([0, sy, 0]), np.array([0, 0, sz])
        self.patch([x0, y0, z1], ex, -ez, finish)
        self.patch([x1, y1, z1], -ex, -ez, finish)
        self.patch([x1, y0, z1], ey, -ez, finish)
        self.patch([x0, y1, z1], -ey, -ez, finish)
        self.patch([x0, y1, z1], ex, -ey, finish)
        self.patch([x0, y0, z0], ex, ey, finish)

    def lathe(self, profile: ArrayLike, center: ArrayLike, finish: Finish, sides: int = 28) -> None:
        """A body of revolution about z: profile (P, 2) of (radius, height) metres, from the top down."""
        profile = np.asarray(profile, dtype=float)
        angles = np.linspace(0, 2 * np.pi, sides + 1)
        ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        circles = profile[:, None, :1] * ring
        heights = np.broadcast_to(profile[:, None, 1:], (len(profile), sides + 1, 1))
        points = np.concatenate([circles, heights], axis=-1).reshape(-1, 3) + np.asarray(center, dtype=float)
        along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
        around = angles * max(float(profile[:, 0].max()), 1e-3)
        scale = finish.tile_m if finish.tile_m > 0 else 1.0
        uv = np.stack(np.meshgrid(around, along), axis=-1).reshape(-1, 2) / scale
        row, col = np.meshgrid(np.arange(len(profile) - 1), np.arange(sides), indexing="ij")
        a = (row * (sides + 1) + col).ravel()
        b, c, d = a + 1, a + sides + 1, a + sides + 2
        self._add(points, np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)]), uv, finish)

    def cylinder(
        self, radius: float, height: float, center: ArrayLike, finish: Finish, top_radius: float | None = None
    ) -> None:
        """An upright closed cylinder or cone around `center` (3,)."""
        top = radius if top_radius is None else top_radius
        half = height / 2
        self.lathe([[0, half], [top, half], [radius, -half], [0, -half]], center, finish)

    def ball(self, radius: float, center: ArrayLike, finish: Finish, stretch: float = 1.0) -> None:
        """A ball, stretched along z."""
        polar = np.linspace(0, np.pi, 15)
        self.lathe(np.stack([radius * np.sin(polar), radius * stretch * np.cos(polar)], 1), center, finish)

    def _add(self, points: np.ndarray, faces: np.ndarray, uv: np.ndarray, finish: Finish) -> None:
        corners = points[faces]
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        faces = faces[area > 1e-10]  # the poles of a lathe
        parts = self._parts
        parts.vertices.append(points @ self._rotation.T + self._origin)
        parts.faces.append(faces + parts.count)
        parts.uvs.append(uv[faces])
        parts.texture_ids.append(np.full(len(faces), finish.texture))
        parts.count += len(points)

    def build(self, lights: tuple[Light, ...], contents: tuple[str, ...]) -> Scene:
        """The finished scene."""
        parts = self._parts
        return Scene(
            np.concatenate(parts.vertices).astype(np.float32),
            np.concatenate(parts.faces).astype(np.int32),
            np.concatenate(parts.uvs).astype(np.float32),
            np.concatenate(parts.texture_ids).astype(np.int16),
            tuple(parts.textures),
            lights=lights,
            contents=contents,
        )
