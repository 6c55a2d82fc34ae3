"""What frames measured of landmarks: pixels and depth of any number of sensors; residuals and their robust weights."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ..core.camera import Camera
from ..core.se3 import cross_matrix, inverse, transform

PIXEL_SCALE = 2.0  # residuals, in sigmas, beyond which an observation loses influence (Cauchy)
DEPTH_SCALE = 1.0  # depth errs with longer tails than pixels
_MIN_Z_M = 0.05


@dataclass(frozen=True)
class Observations:
    """Who saw what. camera, point (M,) int64 indices; uv (M, 2) and sigma_px (M,) pixels; depths (M, S) metres,
    0 = no reading, and sigmas_m (M, S); share_px (M,) of its information that a pixel counts: 1, less where pixels
    share an error."""

    camera: np.ndarray
    point: np.ndarray
    uv: np.ndarray
    sigma_px: np.ndarray
    depths: np.ndarray
    sigmas_m: np.ndarray
    share_px: np.ndarray

    def __len__(self) -> int:
        return len(self.camera)

    def __getitem__(self, kept: np.ndarray) -> Observations:
        return Observations(*(getattr(self, name)[kept] for name in self.__dataclass_fields__))

    def with_points(self, point: np.ndarray) -> Observations:
        """The same, of other point numbers (M,)."""
        return replace(self, point=point)

    def with_whole_pixels(self) -> Observations:
        """The same, every pixel counted whole: what pixels share cancels between a frame and those around it, which
        placed the points that it is held against."""
        return replace(self, share_px=np.ones(len(self)))


def residuals(
    camera: Camera, T_world_camera: np.ndarray, points: np.ndarray, observations: Observations
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened residuals (M, 2 + S) and their derivatives by the motion of the camera (M, 2 + S, 6) and by the point
    (M, 2 + S, 3); T_world_camera (M, 4, 4) and points (M, 3) of each observation. 0 where there is no reading."""
    local = transform(inverse(T_world_camera), points)
    x, y, z = local[:, 0], local[:, 1], np.maximum(local[:, 2], _MIN_Z_M)
    inverse_z = 1 / z
    focal = np.array([camera.fx, camera.fy])
    projected = focal * local[:, :2] * inverse_z[:, None] + np.array([camera.cx, camera.cy])
    zero = np.zeros_like(z)
    d_pixel = np.stack(
        [
            np.stack([camera.fx * inverse_z, zero, -camera.fx * x * inverse_z**2], -1),
            np.stack([zero, camera.fy * inverse_z, -camera.fy * y * inverse_z**2], -1),
        ],
        1,
    ) / observations.sigma_px[:, None, None]  # fmt: skip
    read = observations.depths > 0
    depths = np.where(read, observations.depths, 1.0)
    sharpness = np.where(read, depths**2 / np.maximum(observations.sigmas_m, 1e-6), 0.0)  # 1 / sigma of 1 / depth
    r_depth = (inverse_z[:, None] - 1 / depths) * sharpness
    d_depth = np.zeros((*read.shape, 3))
    d_depth[..., 2] = -(inverse_z**2)[:, None] * sharpness
    r = np.concatenate([(projected - observations.uv) / observations.sigma_px[:, None], r_depth], 1)
    d_local = np.concatenate([d_pixel, d_depth], 1)
    behind = local[:, 2] < _MIN_Z_M
    d_local[behind] = 0.0
    d_motion = np.concatenate([-d_local, d_local @ cross_matrix(local)], -1)
    d_point = d_local @ np.swapaxes(T_world_camera[:, :3, :3], 1, 2)
    return r, d_motion, d_point


def depth_information_factor(observations: Observations) -> np.ndarray:
    """(M, S) share of its information that each depth reading counts: all that a sensor has of a point are one.

    A stereo matcher smooths the same corner in every frame. Were its readings independent, they would outvote the
    pixels, which know better, and bend the trajectory.
    """
    read = observations.depths > 0
    counts = sum_by(observations.point, read.astype(np.float64), int(observations.point.max(initial=-1)) + 1)
    share: np.ndarray = 1 / np.maximum(counts[observations.point], 1.0)
    return share


def robust_weights(
    r: np.ndarray, share_px: np.ndarray, share_depth: np.ndarray | float = 1.0
) -> tuple[np.ndarray, float]:
    """Weights (M, 2 + S) of whitened residuals and their robust cost (Cauchy); the two of a pixel are one residual, of
    which a share (M,) counts, as of each depth reading (M, S)."""
    squared = np.concatenate([np.repeat((r[:, :2] ** 2).sum(1, keepdims=True), 2, 1), r[:, 2:] ** 2], 1)
    scale = np.full(r.shape[1], DEPTH_SCALE**2)
    scale[:2] = PIXEL_SCALE**2
    ratio = squared / scale
    cost, weights = scale * np.log1p(ratio), 1 / (1 + ratio)
    weights[:, :2] *= share_px[:, None]
    weights[:, 2:] *= share_depth
    return weights, float(cost[:, 0] @ share_px + (cost[:, 2:] * share_depth).sum())


def without_outliers(
    camera: Camera, poses: np.ndarray, points: np.ndarray, observations: Observations, limit: float
) -> Observations:
    """The observations whose pixel lies within `limit` sigmas, in front of the camera; depth readings further off than
    twice that are dropped from those."""
    local = transform(inverse(poses[observations.camera]), points[observations.point])
    r, _, _ = residuals(camera, poses[observations.camera], points[observations.point], observations)
    kept = ((r[:, :2] ** 2).sum(1) < limit**2) & (local[:, 2] > _MIN_Z_M)
    depths = np.where(np.abs(r[:, 2:]) < 2 * limit, observations.depths, 0.0)
    return replace(observations, depths=depths)[kept]


def sum_by(index: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sum of values (M, ...) over equal `index` (M,) -> (count, ...)."""
    flat = values.reshape(len(values), math.prod(values.shape[1:]))  # not -1: there may be none
    matrix = sparse.csr_matrix((np.ones(len(index)), (index, np.arange(len(index)))), (count, len(index)))
    total: np.ndarray = (matrix @ flat).reshape(count, *values.shape[1:])
    return total
