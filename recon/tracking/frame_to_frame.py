"""The surfaces of two frames against each other: point-to-plane, pairs by projection (Rusinkiewicz & Levoy 2001)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from ..core.camera import Camera
from ..core.se3 import exceeds, inverse
from .pose_estimation import Linearised, Term, minimise

ROBUST_SCALE = 2.0  # sigmas
MAX_APART = 5.0  # sigmas, beyond which two points are no pair
MIN_COSINE = 0.5  # of the normals of a pair
SHARE = 0.3  # how much of its information a residual counts: neighbours share most of their error
_LEAST_SLANT = 0.1
_FIRST_APART = 15.0  # sigmas, in the first pass
_MIN_PAIRS, _MIN_SHARE = 200, 0.3  # of the points of the source
_MAX_SHIFT_M, _MAX_TURN_RAD = 0.1, 0.1  # from where other evidence has it; beyond, the surfaces slid


@dataclass(frozen=True)
class SurfaceView:
    """What a frame sees of the surface, thinned out: points (h, w, 3) and normals (h, w, 3) in camera axes, metres and
    unit length, sigma (h, w) metres of the depth; `sigma` infinite where there is no reading. `camera` of (h, w)."""

    camera: Camera
    points: np.ndarray
    normals: np.ndarray
    sigma: np.ndarray

    def thinned(self, step: int) -> SurfaceView:
        """Every `step`-th pixel: to be the source; the camera no longer fits."""
        return SurfaceView(self.camera, *(image[::step, ::step] for image in (self.points, self.normals, self.sigma)))

    def blurred(self, metres: float) -> SurfaceView:
        """The same with a depth less certain by that much, which draws from further away."""
        return replace(self, sigma=np.hypot(self.sigma, metres))

    def to_state(self) -> dict[str, Any]:
        """Plain tensors and numbers."""
        images = {name: torch.from_numpy(getattr(self, name)) for name in ("points", "normals", "sigma")}
        return {"camera": self.camera.to_dict(), **images}

    @staticmethod
    def from_state(state: dict[str, Any]) -> SurfaceView:
        """The view of a state."""
        return SurfaceView(Camera(**state["camera"]), *(state[n].numpy() for n in ("points", "normals", "sigma")))

    @property
    def valid(self) -> np.ndarray:
        """(h, w) where there is a measurement."""
        finite: np.ndarray = np.isfinite(self.sigma)
        return finite


def view_residuals(
    target: SurfaceView, source: SurfaceView, T_target_source: np.ndarray, max_apart: float = MAX_APART
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened distances (K,) of the source's points from the target's surface, and their derivatives (K, 6) by the
    motion of the source; of the pairs that are near each other and face the same way."""
    valid = source.valid
    points, sigma, normals = source.points[valid], source.sigma[valid], source.normals[valid]
    rotation = T_target_source[:3, :3]
    local = points @ rotation.T + T_target_source[:3, 3]
    camera = target.camera
    z = np.maximum(local[:, 2], 1e-6)
    u = np.rint(camera.fx * local[:, 0] / z + camera.cx)
    v = np.rint(camera.fy * local[:, 1] / z + camera.cy)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height) & (local[:, 2] > 0.05)
    u, v = u[inside].astype(np.int64), v[inside].astype(np.int64)
    plane, there = target.normals[v, u], target.points[v, u]
    across = local[inside] - there
    ray = there / np.maximum(there[:, 2:], 1e-6)
    own = np.maximum(np.abs((plane * ray).sum(1)), _LEAST_SLANT)  # an error of depth shows in the distance by this much
    spread = np.hypot(target.sigma[v, u], sigma[inside]) * own
    r = (plane * across).sum(1) / spread
    facing = (plane * (normals[inside] @ rotation.T)).sum(1) > MIN_COSINE
    kept = np.isfinite(spread) & (np.abs(r) < max_apart) & facing
    direction = (plane[kept] / spread[kept, None]) @ rotation
    lever = np.cross(points[inside][kept], direction)
    return r[kept], np.concatenate([direction, lever], 1)


def view_term(
    target: SurfaceView,
    T_world_target: np.ndarray,
    source: SurfaceView,
    max_apart: float = MAX_APART,
    share: float = 1.0,
) -> Term:
    """The term of T_world_source in the sum that `minimise` takes; a residual counts a `share` of its information."""
    T_target_world, count = inverse(T_world_target), int(source.valid.sum())
    farthest = ROBUST_SCALE**2 * np.log1p((max_apart / ROBUST_SCALE) ** 2)

    def linearise(pose: np.ndarray) -> Linearised:
        r, jacobian = view_residuals(target, source, T_target_world @ pose, max_apart)
        ratio = (r / ROBUST_SCALE) ** 2
        cost = share * (ROBUST_SCALE**2 * float(np.log1p(ratio).sum()) + farthest * (count - len(r)))
        weighted = share * jacobian / (1 + ratio)[:, None]
        return Linearised(cost, weighted.T @ jacobian, weighted.T @ r)

    return linearise


def align_views(
    target: SurfaceView, source: SurfaceView, T_target_source: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """T_target_source (4, 4) near the given one, and its information (6, 6); None if the surfaces do not fit.

    Where they fit worse than the learned sigmas promise, the information is less by as much. Never more where they fit
    better: the errors of a stereo matcher agree between neighbouring views, and fit well.
    """
    source = source.thinned(2)
    origin = np.eye(4)
    found, _ = minimise(T_target_source, [view_term(target, origin, source, _FIRST_APART)], 8)
    found, information = minimise(found, [view_term(target, origin, source)], 8)
    off = inverse(T_target_source) @ found
    r, _ = view_residuals(target, source, found)
    enough = len(r) >= max(_MIN_PAIRS, _MIN_SHARE * source.valid.sum())
    if not enough or exceeds(off, _MAX_SHIFT_M, _MAX_TURN_RAD):
        return None
    spread = max(1.48 * float(np.median(np.abs(r))), 1.0)
    return found, information * (SHARE / spread**2)
