"""A hand-held-like camera path that keeps clear of everything in a scene."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import open3d as o3d
from scipy.interpolate import Akima1DInterpolator
from scipy.ndimage import label
from scipy.spatial.transform import Rotation

from ...recon.core.errors import DataError

CLEARANCE_M = 0.4
MAX_STEP_M = 0.05  # per frame, hand shake included
MAX_TURN_DEG = 4.0
_PACE_M = 0.040  # the same without the shake
_PACE_RAD = np.radians(3.2)
_EYE_HEIGHT_M = (1.0, 1.75)
_MAX_CANDIDATES = 40_000
_ATTEMPTS = 40
_FINE = 400  # samples between two waypoints


@dataclass(frozen=True)
class FreeSpace:
    """Places where a camera can be: points (N, 3), and the distance to the scene from anywhere."""

    points: np.ndarray
    raycaster: o3d.t.geometry.RaycastingScene
    clearance_m: float

    @staticmethod
    def find(raycaster: o3d.t.geometry.RaycastingScene, low: np.ndarray, high: np.ndarray) -> FreeSpace:
        """The largest connected free space inside the scene, at eye height if there is any. Raises DataError."""
        spacing = max(0.15, float(np.prod(np.maximum(high - low, 0.1)) / _MAX_CANDIDATES) ** (1 / 3))
        axes = [np.arange(low[i] + spacing / 2, high[i], spacing) for i in range(3)]
        shape = tuple(len(axis) for axis in axes)
        nodes = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3).astype(np.float32)
        free = np.zeros(len(nodes), dtype=bool)
        if len(nodes):
            free = _distance(raycaster, nodes) >= CLEARANCE_M
            free[free] = _enclosed(raycaster, nodes[free])
        regions, count = label(free.reshape(shape)) if len(nodes) else (np.zeros(0), 0)
        if count == 0:
            size = " x ".join(f"{edge:.2f}" for edge in high - low)
            raise DataError(
                f"there is no free space {2 * CLEARANCE_M:g} m wide inside the mesh, which is {size} m in size; "
                "it must be a room that surrounds the camera, in metres"
            )
        largest = np.argmax(np.bincount(regions.ravel())[1:]) + 1
        points = nodes[regions.ravel() == largest]
        ground = points[:, 2] - _cast(raycaster, points, np.tile([0.0, 0.0, -1.0], (len(points), 1)))
        height = points[:, 2] - np.quantile(ground, 0.1)  # not above the table top that happens to lie below
        standing = (height >= _EYE_HEIGHT_M[0]) & (height <= _EYE_HEIGHT_M[1])
        return FreeSpace(points[standing] if standing.sum() >= 10 else points, raycaster, CLEARANCE_M)

    def clear(self, points: np.ndarray) -> bool:
        """Whether all points (N, 3) keep the distance."""
        return bool((_distance(self.raycaster, points.astype(np.float32)) >= self.clearance_m).all())

    def openness(self, point: np.ndarray, yaw: float, pitch: float) -> float:
        """Free distance from `point` (3,): a low quantile over a cone of rays, metres; angles in radians."""
        spread = np.stack(np.meshgrid([-0.5, 0, 0.5], [-0.4, 0, 0.4]), -1).reshape(-1, 2)
        forward = np.array([_forward(yaw + dy, pitch + dp) for dy, dp in spread])
        reach = np.minimum(_cast(self.raycaster, np.tile(point, (9, 1)), forward), 100.0)  # infinite through a window
        return float(np.quantile(reach, 0.25))


def _distance(raycaster: o3d.t.geometry.RaycastingScene, points: np.ndarray) -> np.ndarray:
    distances: np.ndarray = raycaster.compute_distance(o3d.core.Tensor(points)).numpy()
    return distances


def _cast(raycaster: o3d.t.geometry.RaycastingScene, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    rays = np.concatenate([origins, directions], axis=-1).astype(np.float32)
    depths: np.ndarray = raycaster.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return depths


def _enclosed(raycaster: o3d.t.geometry.RaycastingScene, points: np.ndarray) -> np.ndarray:
    """(N,) bool: almost every way out of a point (N, 3) ends at a surface."""
    axes = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if x or y or z], float)
    origins = np.repeat(points[:, None], len(axes), axis=1)
    directions = np.broadcast_to(axes, origins.shape)
    return np.isfinite(_cast(raycaster, origins, directions)).mean(axis=1) >= 0.8


def handheld_path(free: FreeSpace, frames: int, rng: np.random.Generator, loops: int = 0) -> np.ndarray:
    """(frames, 4, 4) T_world_camera, OpenCV axes, z up: a walk with glances around, at most 5 cm and 4 degrees a frame.

    With `loops` > 0 the camera is back at its first place and direction `loops` times, evenly spread and the last time
    in the last frame, but for the shake of the hand: about 5 mm and 0.3 degrees.
    Raises DataError if the scene leaves no such way.
    """
    for _ in range(_ATTEMPTS):
        states = _looped(free, frames, loops, rng) if loops else _open(free, frames, rng)
        if states is None:
            continue
        poses = _poses(_shaken(states, rng))
        right_eye = poses[:, :3, 3] + 0.1 * poses[:, :3, 0]
        if free.clear(poses[:, :3, 3]) and free.clear(right_eye):
            return poses
    raise DataError(
        f"no camera path with {free.clearance_m:g} m of clearance was found in {_ATTEMPTS} attempts; "
        "try another --seed, fewer --frames or a roomier mesh"
    )


def walk(stations: np.ndarray, frames: int, rng: np.random.Generator) -> np.ndarray:
    """(frames, 4, 4) T_world_camera along stations (K, 5) x, y, z, yaw, pitch, from the first to the last, at an even
    pace with the shake of a hand."""
    return _poses(_shaken(_resample(_curve(stations), np.linspace(0, 1, frames), stretch=True), rng))


def _next_waypoint(free: FreeSpace, start: np.ndarray, rng: np.random.Generator) -> np.ndarray | None:
    """A free point (3,) that can be reached in a straight line."""
    for _ in range(30):
        goal = free.points[rng.integers(len(free.points))] + rng.uniform(-0.05, 0.05, 3)
        length = np.linalg.norm(goal - start)
        if 0.15 < length < 1.4 and free.clear(start + np.linspace(0, 1, 12)[:, None] * (goal - start)):
            return goal
    return None


def _glance(
    free: FreeSpace, point: np.ndarray, yaw: float, reach: tuple[float, float], rng: np.random.Generator
) -> tuple[float, float]:
    """A direction (yaw, pitch) within `reach` radians of `yaw` that shows something from a distance."""
    best, best_view = (yaw, -0.2), -1.0
    for _ in range(5):
        candidate = (yaw + rng.uniform(*reach), float(np.radians(np.clip(rng.normal(-14, 11), -38, 14))))
        view = min(free.openness(point, *candidate), 1.6)
        if view > best_view:
            best, best_view = candidate, view
    return best


def _open(free: FreeSpace, frames: int, rng: np.random.Generator) -> np.ndarray | None:
    """(frames, 5) states x, y, z, yaw, pitch along a way that is at least as long as the recording."""
    point = free.points[rng.integers(len(free.points))].astype(float)
    turn = rng.choice([-1.0, 1.0])
    states = [np.array([*point, *_glance(free, point, rng.uniform(0, 2 * np.pi), (-0.5, 0.5), rng)])]
    while _cost(np.array(states)).sum() < frames * 1.1 + 10:
        goal = _next_waypoint(free, states[-1][:3], rng)
        if goal is None:
            return None
        turn = -turn if rng.uniform() < 0.15 else turn
        reach = (min(turn * 0.6, turn * 1.8), max(turn * 0.6, turn * 1.8))
        states.append(np.array([*goal, *_glance(free, goal, states[-1][3], reach, rng)]))
    curve = _curve(np.array(states))
    return _resample(curve, np.arange(frames, dtype=float), stretch=False)


def _looped(free: FreeSpace, frames: int, loops: int, rng: np.random.Generator) -> np.ndarray | None:
    """(frames, 5) states of closed rounds through the first state, each shrunk until it fits into its frames."""
    stops = np.rint(np.arange(loops + 1) * (frames - 1) / loops).astype(int)
    first = free.points[rng.integers(len(free.points))].astype(float)
    home = np.array([*first, *_glance(free, first, rng.uniform(0, 2 * np.pi), (-3.0, 3.0), rng)])
    pieces = [home[None]]
    for steps in np.diff(stops):
        full_turn = rng.choice([-1, 1]) * 2 * np.pi if 2 * np.pi / _PACE_RAD < 0.8 * steps else 0.0
        count = int(np.clip(steps / 14, 3, 12))
        away: list[np.ndarray] = []
        for k in range(1, count):
            goal = _next_waypoint(free, away[-1][:3] if away else first, rng)
            if goal is None:
                return None
            yaw, pitch = _glance(free, goal, home[3] + full_turn * k / count, (-0.6, 0.6), rng)
            away.append(np.array([*goal, yaw, pitch]))
        piece = _fitted_round(home, np.array(away), full_turn, int(steps))
        pieces.append(piece[1:])
    return np.concatenate(pieces)


def _fitted_round(home: np.ndarray, away: np.ndarray, full_turn: float, steps: int) -> np.ndarray:
    """(steps + 1, 5) states from `home` by way of `away` (K, 5) and back, `full_turn` radians later."""
    end = home + np.array([0, 0, 0, full_turn, 0])
    ramp = home + np.outer(np.arange(1, len(away) + 1) / (len(away) + 1), end - home)
    low, high = 0.0, 1.0
    curve = _curve(np.stack([home, *(ramp + high * (away - ramp)), end]))
    if _cost(curve).sum() > steps:
        for _ in range(12):
            middle = (low + high) / 2
            curve = _curve(np.stack([home, *(ramp + middle * (away - ramp)), end]))
            low, high = (middle, high) if _cost(curve).sum() <= steps else (low, middle)
        curve = _curve(np.stack([home, *(ramp + low * (away - ramp)), end]))
    return _resample(curve, np.linspace(0, 1, steps + 1), stretch=True)


def _cost(states: np.ndarray) -> np.ndarray:
    """(N - 1,) frames needed between neighbouring states (N, 5)."""
    step = np.diff(states, axis=0)
    walk = np.linalg.norm(step[:, :3], axis=1) / _PACE_M
    turn = np.linalg.norm(step[:, 3:], axis=1) / _PACE_RAD
    return (walk**4 + turn**4) ** 0.25  # a smooth maximum: neither exceeds its pace


def _curve(waypoints: np.ndarray) -> np.ndarray:
    """A smooth curve through waypoints (K, 5), finely sampled."""
    knots = np.concatenate([[0], np.cumsum(np.maximum(_cost(waypoints), 1e-3))])
    fine = np.unique(np.concatenate([np.linspace(a, b, _FINE) for a, b in pairwise(knots)]))
    return Akima1DInterpolator(knots, waypoints)(fine)


def _resample(curve: np.ndarray, at: np.ndarray, stretch: bool) -> np.ndarray:
    """States at `at`: frames along the curve, or shares of its whole length if `stretch`."""
    along = np.concatenate([[0], np.cumsum(_cost(curve))])
    at = at * along[-1] if stretch else np.minimum(at, along[-1])
    return np.stack([np.interp(at, along, column) for column in curve.T], axis=1)


def _shaken(states: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """(N, 6) states with roll and the small slow shake of a hand: about 3 mm and 0.2 degrees."""
    time = np.arange(len(states))[:, None]
    amplitude = np.array([0.002, 0.002, 0.003, 0.002, 0.002, 0.004])
    shaken = np.concatenate([states, np.zeros((len(states), 1))], axis=1)
    for frequency in (0.02, 0.05, 0.11):
        rate = frequency * rng.uniform(0.8, 1.25, 6)
        shaken += amplitude * 0.6 * np.sin(2 * np.pi * (time * rate + rng.uniform(size=6)))
    return shaken


def _forward(yaw: float | np.ndarray, pitch: float | np.ndarray) -> np.ndarray:
    """(..., 3) unit directions in the world; angles in radians."""
    return np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=-1)


def _poses(states: np.ndarray) -> np.ndarray:
    """States (N, 6) x, y, z, yaw, pitch, roll -> (N, 4, 4) T_world_camera."""
    forward = _forward(states[:, 3], states[:, 4])
    right = np.stack([np.sin(states[:, 3]), -np.cos(states[:, 3]), np.zeros(len(states))], axis=-1)
    poses = np.tile(np.eye(4), (len(states), 1, 1))
    poses[:, :3, :3] = np.stack([right, np.cross(forward, right), forward], axis=-1)
    poses[:, :3, :3] @= Rotation.from_rotvec(states[:, 5:] * [[0.0, 0.0, 1.0]]).as_matrix()
    poses[:, :3, 3] = states[:, :3]
    return poses
